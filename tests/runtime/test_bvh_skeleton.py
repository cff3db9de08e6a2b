"""Clips on BVH skeletons of other programs, as pybvh reads them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinegraph.cli import main
from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.formats.bvh import euler_angles
from kinegraph.motion.skeleton import JOINT_INDEX
from support.characters import BIPED, MIXAMO, SIDES, Build, all_points, hierarchy
from support.cli_runs import fails
from support.motions import walk


def bvh(build: Build, order: str = "ZXY", above: str | None = None) -> str:
    """A BVH file of one frame, in the units of the build."""
    rows, points = hierarchy(build), all_points(build)

    def lines(name: str, parent: str | None, key: str) -> list[str]:
        offset = (points[name] - (points[parent] if parent else 0.0)) * build.unit
        turns = " ".join(f"{axis}rotation" for axis in order)
        moves = "Xposition Yposition Zposition "
        body = [f"OFFSET {offset[0]:.6f} {offset[1]:.6f} {offset[2]:.6f}"]
        body.append(f"CHANNELS 6 {moves}{turns}" if key == "ROOT" else f"CHANNELS 3 {turns}")
        children = [child for child, p in rows if p == name]
        for child in children:
            body += lines(child, name, "JOINT")
        if not children:
            body += ["End Site", "{", f"OFFSET 0 0 {0.05 * build.unit}", "}"]
        return [f"{key} {build.names.get(name, name)}", "{", *body, "}"]

    hierarchy_lines = lines("pelvis", None, "ROOT")
    if above:
        turns = " ".join(f"{axis}rotation" for axis in order)
        inner = [line.replace("ROOT", "JOINT") if number == 0 else line for number, line in enumerate(hierarchy_lines)]
        inner[3] = f"CHANNELS 3 {turns}"
        first = [f"ROOT {above}", "{", "OFFSET 0 0 0", f"CHANNELS 6 Xposition Yposition Zposition {turns}"]
        hierarchy_lines = [*first, *inner, "}"]
    return "\n".join(["HIERARCHY", *hierarchy_lines, "MOTION", "Frames: 1", "Frame Time: 0.05", "0 " * 3])


def clip(joints: np.ndarray) -> Clip:
    return Clip(joints=joints, fps=20.0, seed=1, text="a person walks", bundle="none")


@pytest.mark.parametrize("order", ["ZXY", "XYZ", "YZX", "ZYX"])
@pytest.mark.parametrize("above", [None, "Reference"])
def test_pybvh_finds_every_bone_pointing_where_ours_does(
    tmp_path: Path, order: str, above: str | None, figure: Callable[[str], None]
) -> None:
    pybvh = pytest.importorskip("pybvh", reason="needs the extra oracle")
    build, joints = Build(MIXAMO, unit=100.0, arms_down=40.0, fingers=True), walk(40, turning=0.05)
    (tmp_path / "his.bvh").write_text(bvh(build, order, above), encoding="utf-8")
    clip(joints).onto(tmp_path / "his.bvh", fps=20).save(tmp_path / "out.bvh")
    motion = pybvh.read_bvh_file(str(tmp_path / "out.bvh"))
    points, names = np.asarray(motion.joint_positions()), list(motion.joint_names)
    worst = 0.0
    for side in SIDES:
        for upper, lower in (("shoulder", "elbow"), ("elbow", "wrist"), ("collar", "shoulder")):
            ends = [names.index(MIXAMO[f"{side}_{joint}"]) for joint in (upper, lower)]
            theirs = points[:, ends[1]] - points[:, ends[0]]
            ours = joints[:, JOINT_INDEX[f"{side}_{lower}"]] - joints[:, JOINT_INDEX[f"{side}_{upper}"]]
            cosine = (theirs * ours).sum(-1) / np.linalg.norm(theirs, axis=-1) / np.linalg.norm(ours, axis=-1)
            worst = max(worst, float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).max()))
    figure(f"BVH skeleton, channels {order}, joint above {above}: arms at most {worst:.3f} degrees from ours")
    assert worst < 0.5
    pelvis = points[:, names.index(MIXAMO["pelvis"])] / 100.0
    travel = np.linalg.norm((pelvis - joints[:, 0])[:, [0, 2]], axis=-1)
    assert travel.max() < 0.1
    assert motion.fps == pytest.approx(20.0)


@pytest.mark.parametrize("axes", [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)])
def test_euler_angles_of_every_order_make_the_matrix_again(axes: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(3)

    def about(axis: int, angle: float) -> np.ndarray:
        c, s = np.cos(angle), np.sin(angle)
        matrix, (a, b) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
        matrix[a, a] = matrix[b, b] = c
        matrix[a, b], matrix[b, a] = -s, s
        return matrix

    angles = rng.uniform(-3, 3, (200, 3))
    angles[:5, 1] = np.pi / 2
    whole = np.stack([np.linalg.multi_dot([about(a, t) for a, t in zip(axes, row, strict=True)]) for row in angles])
    found = euler_angles(whole[:, None], axes)[:, 0]
    again = np.stack([np.linalg.multi_dot([about(a, t) for a, t in zip(axes, row, strict=True)]) for row in found])
    np.testing.assert_allclose(again, whole, atol=1e-7)


@pytest.mark.parametrize(
    ("edit", "problem"),
    [
        (lambda text: text[:300], "does not end with MOTION|not understood"),
        (lambda text: text.replace("OFFSET", "OFSET", 1), "line 4 of its HIERARCHY is not understood"),
        (lambda text: text.replace("OFFSET 0.0", "OFFSET x.0", 1), "OFFSET is no number"),
        (lambda text: text.replace("OFFSET 0.0", "OFFSET inf", 1), "not understood|not finite|no number"),
        (lambda text: text.replace("Xposition", "Wposition", 1), "has the channels"),
        (lambda text: text.replace("}", "", 1), "not understood|does not end"),
        (lambda text: "\xff" * 10, "."),
        (lambda text: "", "does not end with MOTION"),
        (
            lambda text: text.replace("Xposition Yposition Zposition", "").replace("CHANNELS 6", "CHANNELS 3"),
            "position",
        ),
    ],
)
def test_bad_skeletons_are_refused_and_nothing_is_written(
    tmp_path: Path, edit: Callable[[str], str], problem: str
) -> None:
    (tmp_path / "his.bvh").write_text(edit(bvh(Build(MIXAMO))), encoding="latin-1")
    with pytest.raises(InvalidInputError, match=problem):
        clip(walk(10)).onto(tmp_path / "his.bvh").save(tmp_path / "out.bvh")
    assert not (tmp_path / "out.bvh").exists()


def test_the_command_line_takes_a_skeleton(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], toy_bundle: Path
) -> None:
    his = tmp_path / "his.bvh"
    his.write_text(bvh(Build(BIPED, unit=100.0)), encoding="utf-8")
    words = ["generate", "a person walks", "--bundle", str(toy_bundle), "--seconds", "2", "--skeleton", str(his)]
    assert main([*words, "-o", str(tmp_path / "out.bvh")]) == 0
    capsys.readouterr()
    text = (tmp_path / "out.bvh").read_text(encoding="utf-8")
    assert "ROOT Bip01 Pelvis" in text and "Frames: 60" in text
    assert "is saved as .bvh" in fails(capsys, *words, "-o", str(tmp_path / "out.glb"))
    with pytest.raises(InvalidInputError, match="root motion needs a joint above"):
        clip(walk(10)).onto(his, root=True).save(tmp_path / "root.bvh")


def test_offsets_that_are_no_pose_are_refused(tmp_path: Path) -> None:
    lines = bvh(Build(names=MIXAMO)).splitlines()
    # every bone along +X of its parent, as motion matching data has it
    lines = [
        f"OFFSET {np.linalg.norm([float(value) for value in line.split()[1:]]):.6f} 0 0" if "OFFSET" in line else line
        for line in lines
    ]
    (tmp_path / "flat.bvh").write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InvalidInputError, match="no standing pose"):
        Clip(walk(20), 20.0, 1, "a person walks", "toy 1").onto(tmp_path / "flat.bvh")
