"""The same clip through Blender's own importers, and the README's conversion to FBX, where Blender is installed."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from motions import recorded, walk

from kinegraph.motion.clip import Clip

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = Path(__file__).with_name("blender_joints.py")


def blender(*files: Path) -> dict[str, dict[str, float]]:
    """What `blender_joints.py` found of these files."""
    if shutil.which("blender"):
        command = ["blender", "-b", "--python-exit-code", "1", "--python", str(SCRIPT), "--"]
    elif importlib.util.find_spec("bpy"):
        command = [sys.executable, str(SCRIPT)]
    else:
        pytest.skip("needs Blender: apt-get install blender python3-numpy, or pip install bpy")
    done = subprocess.run([*command, *map(str, files)], capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("{"))
    found: dict[str, dict[str, float]] = json.loads(line)
    return found


def saved(folder: Path, joints: object) -> list[Path]:
    clip = Clip(joints=joints, fps=20.0, seed=1, text="a person walks", bundle="none")  # type: ignore[arg-type]
    files = [folder / f"walk{suffix}" for suffix in (".npz", ".glb", ".bvh")]
    for file in files:
        clip.save(file)
    return files


@pytest.mark.parametrize("real", [False, True], ids=["figure", "recorded"])
def test_blender_puts_the_joints_where_the_clip_has_them(tmp_path: Path, real: bool) -> None:
    joints = recorded(count=1)[0] if real else walk(50, turning=0.05)
    found = blender(*saved(tmp_path, joints))
    for suffix in (".glb", ".bvh"):
        assert found[suffix]["mean_mm"] < 5 and found[suffix]["max_mm"] < 15
        assert found[suffix]["frames"] == len(joints)
    assert found[".glb"]["skinned_vertices"] > 1000


def test_the_fbx_of_the_readme_comes_back_with_its_motion_and_its_body(tmp_path: Path) -> None:
    if shutil.which("blender") is None:
        pytest.skip("needs the program blender: apt-get install blender python3-numpy")
    files = saved(tmp_path, walk(50, turning=0.05))
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"<!-- fbx -->\n```sh\n(.*?)```", readme, flags=re.DOTALL)
    subprocess.run(["bash", "-euc", command], cwd=tmp_path, check=True, capture_output=True, timeout=200)
    found = blender(files[0], tmp_path / "walk.fbx")[".fbx"]
    assert found["mean_mm"] < 5 and found["max_mm"] < 15
    assert found["frames"] == 50 and found["skinned_vertices"] > 1000
