"""VRM animations as the specification wants them; `tests/oracle/test_three.py` plays them in three-vrm."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.formats import encode
from kinegraph.motion.humanoid import VRM_BONES
from kinegraph.motion.skeleton import JOINT_INDEX
from support.characters import unpacked
from support.motions import walk
from support.readers import GlbReader

REQUIRED = {"hips", "spine", "head"} | {
    side + bone
    for side in ("left", "right")
    for bone in ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")
}


def clip() -> Clip:
    return Clip(joints=walk(40, turning=0.05), fps=20.0, seed=1, text="a person walks", bundle="none")


def test_the_humanoid_has_all_bones_and_rests_in_a_t_pose(tmp_path: Path) -> None:
    data = encode(clip(), ".vrma")
    document, _ = unpacked(data)
    bones = document["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"]
    assert bones.keys() >= REQUIRED and bones.keys() == set(VRM_BONES.values())
    assert document["extensionsUsed"] == ["VRMC_vrm_animation"]
    assert all("rotation" not in node and "scale" not in node for node in document["nodes"])
    rest = GlbReader(data, tmp_path).world_transforms(None)
    points = {bone: rest[entry["node"]][:3, 3] for bone, entry in bones.items()}
    for side, sign in (("left", 1), ("right", -1)):
        arm = points[f"{side}Hand"] - points[f"{side}UpperArm"]
        assert sign * arm[0] > 0.4 and np.abs(arm[1:]).max() < 1e-6
        assert points[f"{side}Toes"][2] > points[f"{side}Foot"][2]
        assert points[f"{side}UpperLeg"][0] * sign > 0
    moving = {channel["target"]["path"] for channel in document["animations"][0]["channels"]}
    assert moving == {"translation", "rotation"}
    (hips,) = {
        c["target"]["node"] for c in document["animations"][0]["channels"] if c["target"]["path"] == "translation"
    }
    assert hips == bones["hips"]["node"]


def test_arms_and_hips_move_as_ours(tmp_path: Path) -> None:
    shown, joints = GlbReader(encode(clip(), ".vrma"), tmp_path), clip().joints
    worlds = [shown.world_transforms(frame) for frame in (0, 13, 39)]
    for world, frame in zip(worlds, (0, 13, 39), strict=True):
        for upper, lower in (("left_shoulder", "left_elbow"), ("right_elbow", "right_wrist")):
            theirs = world[JOINT_INDEX[lower]][:3, 3] - world[JOINT_INDEX[upper]][:3, 3]
            ours = joints[frame, JOINT_INDEX[lower]] - joints[frame, JOINT_INDEX[upper]]
            cosine = theirs @ ours / np.linalg.norm(theirs) / np.linalg.norm(ours)
            assert cosine > np.cos(np.radians(0.5))
        assert np.linalg.norm((world[0][:3, 3] - joints[frame, 0])[[0, 2]]) < 0.05


def test_the_validator_of_the_standard_finds_no_fault(tmp_path: Path) -> None:
    folder = os.environ.get("KINEGRAPH_NODE")
    if shutil.which("node") is None or not folder or not Path(folder, "node_modules", "gltf-validator").is_dir():
        pytest.skip("needs node, and KINEGRAPH_NODE, a folder in which gltf-validator was installed with npm")
    script = (
        "require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[1])))"
        ".then(report => console.log(JSON.stringify(report.issues)))"
    )
    (tmp_path / "clip.glb").write_bytes(encode(clip(), ".vrma"))
    process = subprocess.run(
        ["node", "-e", script, str(tmp_path / "clip.glb")], cwd=folder, capture_output=True, text=True, check=True
    )
    assert json.loads(process.stdout)["numErrors"] == 0, process.stdout
