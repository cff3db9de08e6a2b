"""Characters that people use: every .glb, .gltf and .vrm in KINEGRAPH_CHARACTERS, as other programs see them.

No character is in the repository. docs/characters.md says which were tried, and under which licences they are.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.formats.character import Character, read_character
from kinegraph.motion.postprocess import find_contacts, lock_feet
from kinegraph.motion.skeleton import JOINT_INDEX
from support.characters import SIDES
from support.motions import recorded, stand, walk
from support.readers import GlbReader

VARIABLE = "KINEGRAPH_CHARACTERS"
FILES = sorted(
    path
    for path in Path(os.environ.get(VARIABLE) or "no such folder").glob("*")
    if path.suffix in (".glb", ".gltf", ".vrm")
)
CHAINS = (("hip", "knee", "ankle"), ("collar", "shoulder", "elbow", "wrist"))


@pytest.fixture(params=FILES or [None], ids=lambda path: path.stem if path else "none")
def file(request: pytest.FixtureRequest) -> Path:
    if request.param is None:
        pytest.skip(f"needs {VARIABLE}, a folder with characters: see docs/characters.md")
    path: Path = request.param
    return path


@cache
def motions() -> dict[str, np.ndarray]:
    made = {
        "walk": lock_feet(walk(60, turning=0.03), 20.0),
        "wave": lock_feet(stand(60, wave=2.5), 20.0),
        "bow": lock_feet(stand(60, bow=1.0), 20.0),
    }
    try:
        return made | {f"recorded {number}": joints[:80] for number, joints in enumerate(recorded(count=3))}
    except pytest.skip.Exception:
        return made


class Played:
    """A clip on a character as pygltflib has it: nodes (keys, 3) in our frame, in metres of ours."""

    def __init__(self, character: Character, joints: np.ndarray, folder: Path, *, shape: bool = True) -> None:
        bare = character if shape else replace(character, shape=None)
        shown = Clip(joints=joints, fps=20.0, seed=1, text="a clip", bundle="none").onto(bare, fps=20)
        self.data, self.scale = shown.encode(), shown.motion().scale
        nodes = GlbReader(self.data, folder).nodes(-1)
        bones = character.humanoid.bones
        rest = character.rig.positions
        # where it faces at rest, by its hips: x to the left, z ahead
        x = (rest[bones["left_hip"]] - rest[bones["right_hip"]]) * (1, 0, 1)
        x /= np.linalg.norm(x)
        axes = np.stack([x, (0, 1, 0), np.cross(x, (0, 1, 0))])
        self.points = {joint: nodes[node] @ axes.T / self.scale for joint, node in bones.items()}
        self.rest = {joint: axes @ rest[node] / self.scale for joint, node in bones.items()}

    def apart(self, joints: np.ndarray, upper: str, lower: str) -> np.ndarray:
        """Degrees (keys,) between a bone and ours."""
        theirs = self.points[lower] - self.points[upper]
        ours = joints[:, JOINT_INDEX[lower]] - joints[:, JOINT_INDEX[upper]]
        cosine = (theirs * ours).sum(-1) / np.linalg.norm(theirs, axis=-1) / np.linalg.norm(ours, axis=-1)
        return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def bones_of(character: Character, chain: tuple[str, ...]) -> list[tuple[str, str]]:
    limbs = [[f"{side}_{joint}" for joint in chain if f"{side}_{joint}" in character.humanoid.bones] for side in SIDES]
    return [bone for limb in limbs for bone in pairwise(limb)]


def test_bones_point_where_ours_do_and_feet_stand(file: Path, tmp_path: Path, figure: Callable[[str], None]) -> None:
    character = read_character(file)
    arms, legs, moved, heights, paths = [], [], [], [], np.zeros(2)
    for joints in motions().values():
        played, bare = Played(character, joints, tmp_path), Played(character, joints, tmp_path, shape=False)
        arms += [bare.apart(joints, *bone).max() for bone in bones_of(character, CHAINS[1])]
        legs += [bare.apart(joints, *bone) for bone in bones_of(character, CHAINS[0])]
        moved += [
            np.linalg.norm(played.points[f"{side}_wrist"] - bare.points[f"{side}_wrist"], axis=-1) for side in SIDES
        ]
        for side in SIDES:
            foot = f"{side}_foot" if f"{side}_foot" in played.points else f"{side}_ankle"
            ours = joints[:, JOINT_INDEX[f"{side}_foot"]].astype(np.float64)
            for start, end in find_contacts(ours, 20.0):
                if foot.endswith("_foot"):
                    lifted = (
                        played.points[foot][start:end, 1] - played.rest[foot][1] - np.maximum(ours[start:end, 1], 0)
                    )
                    heights.append(float(np.abs(lifted).max()))
                    for index, points in enumerate((played.points[foot], ours)):
                        steps = np.diff(points[start:end][:, [0, 2]], axis=0)
                        paths[index] += np.linalg.norm(steps, axis=-1).sum()
    every, out = np.concatenate(legs), np.concatenate(moved)
    figure(
        f"{file.stem} ({character.humanoid.found_by}): arms at most {max(arms):.2f} degrees from ours, legs mean "
        f"{every.mean():.2f}, 95 % {np.quantile(every, 0.95):.2f}, at most {every.max():.2f}; toes in contact "
        f"at most {1000 * max(heights, default=0):.1f} mm from the height of ours, slide {paths[0]:.2f} m, ours "
        f"{paths[1]:.2f}; hands kept out of the body by up to "
        f"{100 * out.max():.0f} cm in {100 * (out > 0.01).mean():.0f} % of frames"
    )
    assert max(arms) < 2.0 and np.median(every) < 4.0  # of short wide bodies
    assert max(heights, default=0.0) < 0.01
    assert paths[0] < 1.2 * paths[1] + 0.01


def test_the_validator_finds_nothing_that_was_not_there(file: Path, tmp_path: Path) -> None:
    folder = os.environ.get("KINEGRAPH_NODE")
    if shutil.which("node") is None or not folder or not Path(folder, "node_modules", "gltf-validator").is_dir():
        pytest.skip("needs node, and KINEGRAPH_NODE, a folder in which gltf-validator was installed with npm")
    script = (
        "require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[1])))"
        ".then(report => console.log(JSON.stringify(report.issues)))"
    )
    (tmp_path / "moves.glb").write_bytes(Played(read_character(file), motions()["walk"], tmp_path).data)
    errors = []
    for path in (file, tmp_path / "moves.glb"):
        process = subprocess.run(
            ["node", "-e", script, str(path)], cwd=folder, capture_output=True, text=True, check=True
        )
        errors.append(json.loads(process.stdout)["numErrors"])
    assert errors[1] <= errors[0]
