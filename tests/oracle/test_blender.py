"""The same clip through three programs that are not ours, and the documented conversion to FBX."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.formats import NAMED
from kinegraph.motion.skeleton import JOINT_NAMES
from support.characters import BUILDS, hierarchy, make_character
from support.motions import recorded, walk
from support.readers import GlbReader, blender, blender_problem, bvh_joints

ROOT = Path(__file__).resolve().parents[2]
MEAN_MM, MAX_MM = 5.0, 15.0


def saved(folder: Path, joints: np.ndarray, root: bool = False) -> dict[str, Path]:
    """Save a clip as .npz, .glb and .bvh."""
    clip = Clip(joints=joints, fps=20.0, seed=1, text="a person walks", bundle="none")
    files = {suffix: folder / f"walk{suffix}" for suffix in (".npz", ".glb", ".bvh")}
    for suffix, file in files.items():
        clip.save(file, root=root and suffix in NAMED)
    return files


def clip_of(kind: str) -> np.ndarray:
    return recorded(count=1)[0] if kind == "recorded" else walk(50, turning=0.05)


def check(found: dict[str, tuple[float, float]], kind: str, figure: Callable[[str], None]) -> None:
    """Millimetres (mean, max) between where each reader and the clip have the joints."""
    figure(
        f"one {kind} clip read back, mm mean and max: "
        + "; ".join(f"{name} {mean:.2f}, {most:.2f}" for name, (mean, most) in found.items())
    )
    assert all(mean < MEAN_MM and most < MAX_MM for mean, most in found.values())


@pytest.mark.parametrize("kind", ["made", "recorded"])
def test_two_readers_find_the_joints_where_the_clip_has_them(
    tmp_path: Path, kind: str, figure: Callable[[str], None]
) -> None:
    joints = clip_of(kind)
    files = saved(tmp_path, joints)
    glb = GlbReader(files[".glb"].read_bytes(), tmp_path)
    seen = {
        "pygltflib": np.stack([glb.joints(frame) for frame in range(len(joints))]),
        "pybvh": bvh_joints(files[".bvh"])[0],
    }
    apart = {name: 1000 * np.linalg.norm(found - joints, axis=-1) for name, found in seen.items()}
    check({name: (float(each.mean()), float(each.max())) for name, each in apart.items()}, kind, figure)


@pytest.mark.parametrize(("kind", "root"), [("made", False), ("recorded", False), ("made", True)])
def test_blender_is_the_third(tmp_path: Path, kind: str, root: bool, figure: Callable[[str], None]) -> None:
    joints = clip_of(kind)
    report = blender(*saved(tmp_path, joints, root).values())
    found = {
        f"Blender {report['blender']} {suffix}{' with a root joint' if root else ''}": (
            report[suffix]["mean_mm"],
            report[suffix]["max_mm"],
        )
        for suffix in (".glb", ".bvh")
    }
    check(found, kind, figure)
    for suffix in (".glb", ".bvh"):
        assert report[suffix]["frames"] == len(joints)
        assert set(report[suffix]["bones"]) == {*JOINT_NAMES, *(["root"] if root else [])}
        lowest, pelvis = report[suffix]["rest_heights"]
        assert abs(lowest) < 1e-4 and 0.7 < pelvis < 1.1
    assert report[".glb"]["skinned_vertices"] > 1000


@pytest.mark.parametrize("root", [False, True])
def test_the_documented_fbx_comes_back_with_its_motion_and_its_body_and_nothing_else(
    tmp_path: Path, root: bool, figure: Callable[[str], None]
) -> None:
    if blender_problem():
        pytest.skip(blender_problem())
    files = saved(tmp_path, walk(50, turning=0.05), root)
    page = (ROOT / "docs" / "engines.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"<!-- fbx -->\n```sh\n(.*?)```", page, flags=re.DOTALL)
    subprocess.run(["bash", "-euc", command], cwd=tmp_path, check=True, capture_output=True, timeout=200)
    report = blender(files[".npz"], tmp_path / "walk.fbx")
    found = report[".fbx"]
    figure(
        f"FBX of the recipe in Blender {report['blender']}, root {root}: {found['objects']}, {found['max_mm']:.2f} mm"
    )
    assert found["mean_mm"] < MEAN_MM and found["max_mm"] < MAX_MM
    assert found["frames"] == 50 and found["skinned_vertices"] > 1000
    assert found["objects"] == ["Armature", "body"]
    assert set(found["bones"]) == {*JOINT_NAMES, *(["root"] if root else [])}
    assert abs(found["rest_heights"][0]) < 1e-3


@pytest.mark.parametrize("name", ["Unreal, A-pose, Z up, twist", "Rigify, A-pose", "Unity, wide and short"])
def test_a_character_moves_in_blender_as_pygltflib_has_it(
    tmp_path: Path, name: str, figure: Callable[[str], None]
) -> None:
    hero = tmp_path / "hero.glb"
    hero.write_bytes(make_character(BUILDS[name], lambda document: document.pop("animations")))
    clip = Clip(joints=walk(50, turning=0.05), fps=20.0, seed=1, text="a person walks", bundle="none")
    data = clip.onto(hero, fps=20).encode()
    points = GlbReader(data, tmp_path).points(-1)
    nodes = [BUILDS[name].names.get(joint, joint) for joint, _ in hierarchy(BUILDS[name])]
    (tmp_path / "walks.glb").write_bytes(data)
    np.savez(tmp_path / "walks.npz", joints=points, joint_names=nodes, fps=20.0)
    report = blender(tmp_path / "walks.npz", tmp_path / "walks.glb")
    found = report[".glb"]
    figure(f"{name} in Blender {report['blender']}: {found['max_mm']:.3f} mm from pygltflib at most")
    assert found["max_mm"] < 1.0
    assert found["frames"] == 50 and found["skinned_vertices"] > 100
