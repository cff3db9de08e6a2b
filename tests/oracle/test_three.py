"""Characters and VRM animations as three.js plays them, where npm has installed it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.motion.skeleton import JOINT_INDEX
from support.characters import BUILDS, LIMBS, SIDES, hierarchy, make_character
from support.motions import walk, with_recorded
from support.readers import GlbReader

SCRIPT = Path(__file__).with_name("three_points.mjs")
PACKAGES = ("three", "@pixiv/three-vrm", "@pixiv/three-vrm-animation")


def three(*files: Path) -> dict[str, Any]:
    folder = Path(os.environ.get("KINEGRAPH_NODE", ""))
    missing = [name for name in PACKAGES if not (folder / "node_modules" / name).is_dir()]
    if shutil.which("node") is None or missing:
        pytest.skip(f"needs node, and KINEGRAPH_NODE, a folder in which npm installed {', '.join(PACKAGES)}")
    command = ["node", "--input-type=module", "-", *map(str, files)]
    script = SCRIPT.read_text(encoding="utf-8")
    process = subprocess.run(
        command, input=script, cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert process.returncode == 0, process.stderr[-2000:]
    report: dict[str, Any] = json.loads(process.stdout)
    return report


@pytest.mark.parametrize("name", ["Mixamo, T-pose, centimetres", "Unreal, A-pose, Z up, twist"])
def test_a_character_moves_in_three_as_pygltflib_has_it(
    tmp_path: Path, name: str, figure: Callable[[str], None]
) -> None:
    (tmp_path / "hero.glb").write_bytes(make_character(BUILDS[name]))
    clip = Clip(joints=walk(30, turning=0.05), fps=20.0, seed=1, text="a person walks", bundle="none")
    data = clip.onto(tmp_path / "hero.glb", fps=20).encode()
    (tmp_path / "walks.glb").write_bytes(data)
    report = three(tmp_path / "walks.glb")
    seen = np.array(report["frames"])
    points = GlbReader(data, tmp_path).points(-1)[:, report["nodes"]]
    apart = 1000 * float(np.abs(seen - points)[:-1].max())
    figure(f"{name} in three.js {report['three']}: {apart:.3f} mm from pygltflib at most")
    assert apart < 0.1


@pytest.mark.parametrize("name", ["VRM 1, long legs", "VRoid by its VRM 0, facing back"])
def test_a_vrm_animation_moves_a_vrm_character_as_ours(
    tmp_path: Path, name: str, figure: Callable[[str], None]
) -> None:
    build = BUILDS[name]

    def with_meta(document: dict[str, Any]) -> None:
        for extension in document["extensions"].values():
            licence = {"licenseUrl": "https://vrm.dev/licenses/1.0/"}
            extension["meta"] = {"name": "test", "title": "test", "authors": ["test"], **licence}
            extension.setdefault("specVersion", "0.0")

    (tmp_path / "hero.vrm").write_bytes(make_character(build, with_meta))
    worst: dict[str, float] = {}
    for joints in (clip[:60] for clip in with_recorded([walk(30)], 3)):
        clip = Clip(joints=joints, fps=20.0, seed=1, text="a person walks", bundle="none")
        clip.save(tmp_path / "clip.vrma", force=True)
        report = three(tmp_path / "hero.vrm", tmp_path / "clip.vrma")
        frames = np.array(report["frames"])
        index = {joint: report["nodes"].index(number) for number, (joint, _) in enumerate(hierarchy(build))}
        turned = np.array([-1.0, 1.0, -1.0]) if build.facing else np.ones(3)
        for side in SIDES:
            for upper, lower in pairwise(LIMBS):
                if upper in ("foot", "ankle", "wrist"):
                    continue
                ours = joints[:, JOINT_INDEX[f"{side}_{lower}"]] - joints[:, JOINT_INDEX[f"{side}_{upper}"]]
                theirs = (frames[:, index[f"{side}_{lower}"]] - frames[:, index[f"{side}_{upper}"]]) * turned
                cosine = (ours * theirs).sum(-1) / np.linalg.norm(ours, axis=-1) / np.linalg.norm(theirs, axis=-1)
                angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))[:-1].max())
                worst[upper] = max(worst.get(upper, 0.0), angle)
    figure(f"{name} plays a .vrma in three-vrm, degrees from ours at most: {worst}")
    # a VRM animation turns bones against their rest: collars and shins rest as the character has them
    assert max(angle for joint, angle in worst.items() if joint != "collar") < 8.0
    assert max(worst["shoulder"], worst["elbow"]) < 0.5
