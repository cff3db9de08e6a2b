"""The same clip through three programs that are not ours, and the README's conversion to FBX."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from motions import recorded, walk
from readers import GlbReader, blender, bvh_joints

from kinegraph.motion.clip import Clip

ROOT = Path(__file__).resolve().parents[2]
MEAN_MM, MAX_MM = 5.0, 15.0


def saved(folder: Path, joints: np.ndarray) -> dict[str, Path]:
    """A clip as .npz, .glb and .bvh."""
    clip = Clip(joints=joints, fps=20.0, seed=1, text="a person walks", bundle="none")
    files = {suffix: folder / f"walk{suffix}" for suffix in (".npz", ".glb", ".bvh")}
    for file in files.values():
        clip.save(file)
    return files


@pytest.mark.parametrize("real", [False, True], ids=["figure", "recorded"])
def test_three_readers_find_the_joints_where_the_clip_has_them(
    tmp_path: Path, real: bool, figure: Callable[[str], None]
) -> None:
    joints = recorded(count=1)[0] if real else walk(50, turning=0.05)
    files = saved(tmp_path, joints)
    glb = GlbReader(files[".glb"].read_bytes(), tmp_path)
    seen = {
        "pygltflib": np.stack([glb.joints(frame) for frame in range(len(joints))]),
        "pybvh": bvh_joints(files[".bvh"])[0],
    }
    apart = {name: 1000 * np.linalg.norm(found - joints, axis=-1) for name, found in seen.items()}
    found = {name: (float(each.mean()), float(each.max())) for name, each in apart.items()}
    report = blender(*files.values())
    for suffix in (".glb", ".bvh"):
        found[f"Blender {report['blender']} {suffix}"] = (report[suffix]["mean_mm"], report[suffix]["max_mm"])
        assert report[suffix]["frames"] == len(joints)
    figure(
        f"one {'recorded' if real else 'made'} clip read back, mm mean and max: "
        + "; ".join(f"{name} {mean:.2f}, {most:.2f}" for name, (mean, most) in found.items())
    )
    assert all(mean < MEAN_MM and most < MAX_MM for mean, most in found.values())
    assert report[".glb"]["skinned_vertices"] > 1000


def test_the_fbx_of_the_readme_comes_back_with_its_motion_and_its_body(tmp_path: Path) -> None:
    if shutil.which("blender") is None:
        pytest.skip("needs the program blender: apt-get install blender python3-numpy")
    files = saved(tmp_path, walk(50, turning=0.05))
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"<!-- fbx -->\n```sh\n(.*?)```", readme, flags=re.DOTALL)
    subprocess.run(["bash", "-euc", command], cwd=tmp_path, check=True, capture_output=True, timeout=200)
    found = blender(files[".npz"], tmp_path / "walk.fbx")[".fbx"]
    assert found["mean_mm"] < MEAN_MM and found["max_mm"] < MAX_MM
    assert found["frames"] == 50 and found["skinned_vertices"] > 1000
