"""GLB read back by an independent program, and the body that it shows."""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.formats import WRITERS, encode
from kinegraph.formats.glb_mesh import body_mesh
from kinegraph.motion.kinematics import rest_offsets
from kinegraph.motion.skeleton import CONVENTIONS, JOINT_INDEX, JOINTS, PARENTS, facing_angle
from support.cli_runs import fails, not_loaded
from support.motions import walk, with_recorded
from support.readers import GlbReader


def clip(joints: np.ndarray, text: str = "a person walks") -> Clip:
    return Clip(joints=joints, fps=20.0, seed=2**40, text=text, bundle="edge 1.2")


def motions() -> list[np.ndarray]:
    return with_recorded([walk(50, turning=0.05)], 3)


def test_a_reader_of_glb_finds_the_joints_of_the_clip(tmp_path: Path) -> None:
    for joints in motions():
        reader = GlbReader(encode(clip(joints), ".glb"), tmp_path)
        for frame in (0, len(joints) // 2, len(joints) - 1):
            error = np.linalg.norm(reader.joints(frame) - joints[frame], axis=-1)
            assert error.mean() < 0.005 and error.max() < 0.015
        times = reader.array(reader.file.animations[0].samplers[0].input)[:, 0]
        np.testing.assert_allclose(times, np.arange(len(joints)) / 20.0, atol=1e-5)


def test_the_skin_leaves_the_rest_pose_as_it_is_and_carries_the_body_along(tmp_path: Path) -> None:
    joints = walk(40)
    reader = GlbReader(encode(clip(joints), ".glb"), tmp_path)
    part = reader.file.meshes[0].primitives[0].attributes
    positions, skin_joints = reader.array(part.POSITION), reader.array(part.JOINTS_0)
    weights = reader.array(part.WEIGHTS_0)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    inverse = reader.array(reader.file.skins[0].inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
    homogeneous = np.column_stack([positions, np.ones(len(positions))])
    for frame in (None, 20):
        world = reader.world_transforms(frame)
        bound = np.stack([world[node] for node in reader.file.skins[0].joints]) @ inverse
        skinned = np.einsum("nij,nj->ni", bound[skin_joints[:, 0]], homogeneous)[:, :3]
        assert abs(skinned[:, 1].min()) < 0.06 and 1.4 < skinned[:, 1].max() < 2.1
        for joint in range(JOINTS):
            vertices = skinned[skin_joints[:, 0] == joint]
            if len(vertices):
                assert np.linalg.norm(vertices - world[joint][:3, 3], axis=-1).min() < 0.15


@pytest.mark.parametrize("root", [False, True])
def test_the_rest_and_the_bind_pose_stand_on_the_floor(tmp_path: Path, root: bool) -> None:
    for joints in motions():
        reader = GlbReader(encode(clip(joints), ".glb", root=root), tmp_path)
        world, skin = reader.world_transforms(None), reader.file.skins[0]
        rest = np.stack([world[node] for node in skin.joints])
        inverse = reader.array(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
        np.testing.assert_allclose(rest @ inverse, np.tile(np.eye(4), (len(rest), 1, 1)), atol=1e-6)
        place = rest[:JOINTS, :3, 3]
        assert place[:, 1].min() == pytest.approx(0.0, abs=1e-6)
        assert place[0, 0] == place[0, 2] == 0.0 and 0.7 < place[0, 1] < 1.1
        # the arms are out to the sides, and the soles are near the floor
        wrists = place[[JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"]]]
        assert wrists[0, 0] > 0.4 and wrists[1, 0] < -0.4 and (wrists[:, 1] > place[0, 1] + 0.3).all()
        soles = reader.array(reader.file.meshes[0].primitives[0].attributes.POSITION)[:, 1].min()
        assert abs(soles) < 0.03


@pytest.mark.parametrize("turning", [0.0, 0.1])
def test_a_root_joint_carries_travel_and_heading_and_leaves_the_joints_where_they_are(
    tmp_path: Path, turning: float
) -> None:
    joints = walk(60, turning=turning)
    for names, expected in CONVENTIONS.items():
        plain = GlbReader(encode(clip(joints), ".glb", names), tmp_path)
        reader = GlbReader(encode(clip(joints), ".glb", names, True), tmp_path)
        assert tuple(node.name for node in reader.file.nodes) == (*expected, "root", "body")
        assert reader.file.nodes[JOINTS].children == [0]
        assert reader.file.scenes[0].nodes == [JOINTS, JOINTS + 1] and reader.file.skins[0].skeleton == JOINTS
        assert len(reader.file.skins[0].joints) == JOINTS + 1
        for frame in (0, 31, 59):
            world = reader.world_transforms(frame)
            np.testing.assert_allclose(reader.joints(frame)[:JOINTS], plain.joints(frame), atol=1e-6)
            np.testing.assert_allclose(world[JOINTS][:3, 3], joints[frame, 0] * (1, 0, 1), atol=1e-6)
            np.testing.assert_allclose(world[JOINTS][:3, 1], (0, 1, 0), atol=1e-6)
            ahead = np.arctan2(world[JOINTS][0, 2], world[JOINTS][2, 2])
            heading = float(facing_angle(joints)[frame])
            assert abs(np.angle(np.exp(1j * (ahead - heading)))) < 1e-5
            # relative to the root the pelvis hardly moves over the floor and hardly turns
            pelvis = np.linalg.inv(world[JOINTS]) @ world[0]
            assert np.abs(pelvis[[0, 2], 3]).max() < 1e-3
            assert pelvis[2, 2] > 0.95


def test_the_root_of_a_clip_in_place_stays_and_that_of_a_loop_closes(tmp_path: Path) -> None:
    walking = clip(walk(80, turning=0.03))
    tracks = root_tracks(walking.in_place(), tmp_path)
    assert np.ptp(tracks["translation"], axis=0).max() < 1e-6
    loop = walking.looped()
    tracks, pelvis = root_tracks(loop, tmp_path), root_tracks(loop, tmp_path, 0)
    assert np.linalg.norm(tracks["translation"][-1] - tracks["translation"][0]) > 0.3
    for path in ("translation", "rotation"):
        np.testing.assert_allclose(pelvis[path][-1], pelvis[path][0], atol=1e-4)
    tracks = root_tracks(loop.in_place(), tmp_path)
    for path in ("translation", "rotation"):
        np.testing.assert_allclose(tracks[path][-1], tracks[path][0], atol=1e-5)


def root_tracks(shown: Clip, folder: Path, node: int = JOINTS) -> dict[str, np.ndarray]:
    reader = GlbReader(encode(shown, ".glb", root=True), folder)
    animation = reader.file.animations[0]
    return {
        channel.target.path: reader.array(animation.samplers[channel.sampler].output)
        for channel in animation.channels
        if channel.target.node == node
    }


def test_the_file_says_where_it_comes_from_and_names_its_joints(tmp_path: Path) -> None:
    text = "Ein Mensch geht „schnell“ 走る"
    for names, expected in CONVENTIONS.items():
        reader = GlbReader(encode(clip(walk(20), text), ".glb", names), tmp_path)
        assert tuple(node.name for node in reader.file.nodes[:JOINTS]) == expected
        assert reader.file.asset.extras == {"text": text, "seed": str(2**40), "bundle": "edge 1.2", "fps": 20.0}
    assert len({name for names in CONVENTIONS.values() for name in names}) == JOINTS * len(CONVENTIONS)


def test_equal_clips_give_equal_bytes_in_whole_chunks() -> None:
    data = encode(clip(walk(20)), ".glb")
    assert data == encode(clip(walk(20)), ".glb")
    magic, version, length = struct.unpack("<4sII", data[:12])
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack("<I4s", data[12:20])
    document = json.loads(data[20 : 20 + size])
    assert kind == b"JSON" and size % 4 == 0
    assert document["buffers"][0]["byteLength"] == len(data) - 28 - size


def test_the_body_is_closed_and_its_normals_point_outwards() -> None:
    offsets = rest_offsets(walk(20))
    rest = np.zeros((JOINTS, 3))
    for joint in range(1, JOINTS):
        rest[joint] = rest[PARENTS[joint]] + offsets[joint]
    body = body_mesh(rest)
    corners = body.positions[body.triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((facing * body.normals[body.triangles].sum(axis=1)).sum(axis=-1) > 0).all()
    # the divergence theorem: the enclosed volume is positive, and that of a slim person (limbs overlap)
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert 0.03 < volume < 0.12
    np.testing.assert_allclose(np.linalg.norm(body.normals, axis=-1), 1.0)


def test_the_validator_of_the_standard_finds_no_fault(tmp_path: Path) -> None:
    folder = os.environ.get("KINEGRAPH_NODE")
    if shutil.which("node") is None or not folder or not Path(folder, "node_modules", "gltf-validator").is_dir():
        pytest.skip("needs node, and KINEGRAPH_NODE, a folder in which gltf-validator was installed with npm")
    script = (
        "require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[1])))"
        ".then(report => console.log(JSON.stringify(report.issues)))"
    )
    for root in (False, True):
        (tmp_path / "clip.glb").write_bytes(encode(clip(walk(30)), ".glb", "mixamo", root))
        process = subprocess.run(
            ["node", "-e", script, str(tmp_path / "clip.glb")], cwd=folder, capture_output=True, text=True, check=True
        )
        issues = json.loads(process.stdout)
        assert issues["numErrors"] == issues["numWarnings"] == issues["numInfos"] == 0, issues


def test_names_are_refused_where_there_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walking: Any = clip(walk(20))
    with pytest.raises(InvalidInputError, match="one of smpl, mixamo, not 'unreal'"):
        walking.save(tmp_path / "a.glb", names="unreal")
    with pytest.raises(InvalidInputError, match=r"are for .bvh, .glb, not for .npz"):
        walking.save(tmp_path / "a.npz", names="mixamo")
    assert list(tmp_path.iterdir()) == []
    words = ["generate", "a person walks", "-o", str(tmp_path / "a.npz"), "--names", "mixamo"]
    assert "not for .npz" in fails(capsys, *words)


def test_a_root_joint_is_refused_where_there_is_no_skeleton(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinegraph.pipeline.MotionPipeline.load", not_loaded)
    for suffix in sorted(WRITERS.keys() - {".bvh", ".glb"}):
        with pytest.raises(InvalidInputError, match=rf"a root joint is for .bvh, .glb, not for {suffix}"):
            encode(clip(walk(9)), suffix, root=True)
        for command in (["generate", "a person walks"], ["compose", "--and", "x"], ["sequence", "x", "y"]):
            assert f"not for {suffix}" in fails(capsys, *command, "-o", str(tmp_path / f"a{suffix}"), "--root")
    assert list(tmp_path.iterdir()) == []
