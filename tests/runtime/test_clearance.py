"""Arms keep out of stout bodies, and the arms of others are left alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.formats.character import read_character
from kinegraph.motion.body_shape import CIRCLES, LEVELS, BodyShape, fit_shape
from kinegraph.motion.clearance import SOFT, Segment, clear_arms, push_of_thigh, push_of_trunk
from support.characters import BUILDS, MIXAMO, SIDES, UNREAL, Build, hierarchy, make_character
from support.motions import posed, stand, turn, walk
from support.readers import GlbReader

STOUT = {
    "T-pose": Build(MIXAMO, girth=3.0, unit=100.0, node_scale=0.01, roll=1),
    "A-pose, facing aside": Build(UNREAL, girth=3.0, arms_down=50.0, roll=2, z_up_node=True, above="root", facing=90.0),
}
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def clip(joints: np.ndarray) -> Clip:
    return Clip(joints=joints, fps=20.0, seed=1, text="a person walks", bundle="none")


def hands_in_front(frames: int = 60) -> np.ndarray:
    """Arms that hang close to the body; then the hands meet before the belly, and come back: (frames, 22, 3)."""
    rows = []
    for frame in range(frames):
        share = np.sin(np.pi * frame / (frames - 1)) ** 2
        turns = {
            16: turn("z", -1.45) @ turn("y", -0.2 * share),
            17: turn("z", 1.45) @ turn("y", 0.2 * share),
            18: turn("y", -1.5 * share),
            19: turn("y", 1.5 * share),
        }
        rows.append(posed(np.array([0.0, 0.95, 0.0]), turns))
    joints = np.stack(rows)
    joints[..., 1] -= joints[..., 1].min()
    return joints.astype(np.float32)


def from_the_spine(data: bytes, build: Build, folder: Path) -> np.ndarray:
    """Metres (keys, points) from elbows, forearms and wrists to the line pelvis, spine, chest, in the played file."""
    points = GlbReader(data, folder).points(-1) / (build.unit * build.node_scale)
    shown = {name: points[:, number] for number, (name, _) in enumerate(hierarchy(build))}
    arms = [
        shown[f"{side}_elbow"] + share * (shown[f"{side}_wrist"] - shown[f"{side}_elbow"])
        for side in SIDES
        for share in (0.0, 0.5, 1.0)
    ]
    spine = [shown[name] for name in ("pelvis", "spine1", "spine2", "spine3")]
    nearest = []
    for point in arms:
        apart = []
        for start, end in pairwise(spine):
            bone = end - start
            along = np.clip(((point - start) * bone).sum(-1) / (bone * bone).sum(-1), 0.0, 1.0)
            apart.append(np.linalg.norm(point - start - along[:, None] * bone, axis=-1))
        nearest.append(np.min(apart, axis=0))
    return np.stack(nearest, axis=1)


@pytest.mark.parametrize("name", STOUT)
@pytest.mark.parametrize("motion", ["walk", "bow", "hands in front"])
def test_arms_of_a_stout_character_stay_out_of_its_trunk(
    tmp_path: Path, name: str, motion: str, figure: Callable[[str], None]
) -> None:
    build = STOUT[name]
    joints = {"walk": walk(60, turning=0.03), "bow": stand(60, bow=0.6), "hands in front": hands_in_front()}[motion]
    (tmp_path / "stout.glb").write_bytes(make_character(build))
    (tmp_path / "slim.glb").write_bytes(make_character(replace(build, girth=1.0)))
    stout, slim = (
        from_the_spine(clip(joints).onto(tmp_path / file, fps=20).encode(), build, tmp_path)
        for file in ("stout.glb", "slim.glb")
    )
    half = 0.1 * build.girth
    figure(
        f"{name}, {motion}: arms at least {stout.min():.3f} m from the spine of a body of half width {half:.2f} m; "
        f"as our body has them, {slim.min():.3f} m"
    )
    assert slim.min() < 0.95 * half  # or there is nothing to keep out of
    assert stout.min() > 0.95 * half


def test_what_moves_smoothly_stays_smooth(tmp_path: Path) -> None:
    (tmp_path / "stout.glb").write_bytes(make_character(STOUT["T-pose"]))
    joints = hands_in_front(120)
    points = GlbReader(clip(joints).onto(tmp_path / "stout.glb", fps=20).encode(), tmp_path).points(-1)
    number = [name for name, _ in hierarchy(STOUT["T-pose"])].index("left_wrist")
    jumps = np.linalg.norm(np.diff(points[:, number], n=2, axis=0), axis=-1)
    assert jumps.max() < 0.004  # metres a frame^2; ours 0.0006, a flip of the side 0.3


def test_other_characters_keep_their_arms(tmp_path: Path) -> None:
    for name in ("Mixamo, T-pose, centimetres", "VRM 1, long legs", "nameless, by its shape"):
        (tmp_path / "hero.glb").write_bytes(make_character(BUILDS[name]))
        character = read_character(tmp_path / "hero.glb")
        assert character.shape is not None
        bare = replace(character, shape=None)
        for joints in (walk(40), stand(40, wave=2.5, bow=0.3)):
            assert clip(joints).onto(character).encode() == clip(joints).onto(bare).encode(), name


def test_a_character_is_measured_whatever_its_unit_and_heading(tmp_path: Path) -> None:
    for name, build in STOUT.items():
        (tmp_path / "hero.glb").write_bytes(make_character(build))
        shape = read_character(tmp_path / "hero.glb").shape
        assert shape is not None, name
        unit = build.unit * build.node_scale
        # a box of half width 0.3: its ellipse is at most a fifth wider, to hold the corners
        belly = shape.half_widths[LEVELS // 2] / unit, shape.half_depths[LEVELS // 2] / unit
        assert min(belly) > 0.29 and max(belly) < 0.3 * 1.25
        assert 0.025 < shape.forearm / unit < 0.08  # a box of 4 cm about the bone, slanted in the A-pose
        # a square bar of half width 0.12 about the thigh
        assert 0.1 < np.median(shape.thighs) / unit < 0.17
        np.testing.assert_allclose(shape.palms[0] * (1, -1, -1) + shape.palms[1] * (1, 1, 1), 0, atol=0.02 * unit)


def test_wings_belts_and_too_little_skin_do_not_count() -> None:
    rng = np.random.default_rng(3)
    bones = {f"{side}_{joint}": number for number, (side, joint) in enumerate(
        (side, joint) for side in SIDES for joint in ("shoulder", "elbow", "wrist", "hip", "knee"))}  # fmt: skip
    places = {"shoulder": (0.2, 1.4), "elbow": (0.45, 1.4), "wrist": (0.7, 1.4), "hip": (0.1, 0.9), "knee": (0.1, 0.5)}
    joints = np.array([(x if side == "left" else -x, y, 0) for side in SIDES for x, y in places.values()], dtype=float)
    angle = rng.uniform(0, 2 * np.pi, 4000)
    trunk = np.stack([0.15 * np.cos(angle), rng.uniform(0.85, 1.4, 4000), 0.1 * np.sin(angle)], axis=1)
    ends = [[joints[bones[f"{side}_{joint}"]] for joint in ("elbow", "wrist")] for side in SIDES]
    arms = [a + rng.normal(0, 0.02, (500, 3)) + np.outer(rng.uniform(0, 1, 500), b - a) for a, b in ends]
    belt = trunk[:100] * (3.0, 1.0, 3.0)
    points = np.concatenate([trunk, belt, *arms])
    parts = np.array(["trunk"] * 4100 + ["left_elbow"] * 500 + ["right_elbow"] * 500)
    shape = fit_shape(points, parts, joints, bones)
    assert shape is not None
    np.testing.assert_allclose(shape.half_widths, 0.15, rtol=0.1)
    np.testing.assert_allclose(shape.half_depths, 0.1, rtol=0.1)
    assert not shape.thighs.any()  # nothing is bound to them
    assert fit_shape(points[:20], parts[:20], joints, bones) is None
    wide = fit_shape(points * np.where(parts == "trunk", 5.0, 1.0)[:, None], parts, joints, bones)
    assert wide is None or wide.half_widths.max() <= 0.2 * 1.75 + 1e-9


def round_trunk(radius: float = 0.3, forearm: float = 0.04) -> BodyShape:
    """A cylinder about the spine from 0.8 to 1.4 m."""
    row = np.full(LEVELS, radius)
    heights = np.linspace(0.8, 1.4, LEVELS)
    return BodyShape(heights, row, row, row * 0, np.full((2, CIRCLES), 0.1), forearm, np.zeros((2, 3)))


def test_the_push_leads_straight_out_to_the_surface_and_sets_in_smoothly() -> None:
    shape = round_trunk()
    still = np.tile(IDENTITY, (1, 1))
    pelvis, chest = (Segment(np.array([0, y, 0]), np.array([[0, y, 0]]), still) for y in (0.9, 1.3))
    push = push_of_trunk(shape, pelvis, chest)
    surface = 0.34
    for angle in (0.0, 0.7, 2.0, 4.0):
        out = np.array([np.sin(angle), 0.0, np.cos(angle)])
        for radius in (0.2, 0.3, surface - SOFT - 1e-6):
            moved = push((radius * out + (0, 1.1, 0))[None, None])[0, 0]
            np.testing.assert_allclose(moved, (surface - radius) * out, atol=1e-6)
        assert not push(((surface + SOFT) * out + (0, 1.1, 0))[None, None]).any()
    # once continuously differentiable: a smooth function's second difference is of second order
    radii = np.arange(0.15, 0.4, 1e-3)
    places = np.stack([radii, radii * 0 + 1.1, radii * 0], axis=1)[None]
    second = np.diff(push(places)[0, :, 0], n=2)
    assert np.abs(second).max() < 1e-3 * 1e-3 / (2 * SOFT) * 1.5
    assert not push(np.array([[[0.1, 0.5, 0.0], [0.1, 1.6, 0.0], [0.0, 1.1, 0.0]]])).any()
    # on its side, the trunk pushes along what is sideways there
    quarter = np.array([[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])
    laid = [Segment(np.array([0, y, 0]), np.array([[-y, 0, 0]]), quarter) for y in (0.9, 1.3)]
    moved = push_of_trunk(shape, *laid)(np.array([[[-1.1, 0.2, 0.0]]]))[0, 0]
    np.testing.assert_allclose(moved, (0.0, surface - 0.2, 0.0), atol=1e-6)


def test_thighs_push_hands_away_from_their_bone() -> None:
    hip, knee = np.array([0.1, 0.9, 0.0]), np.array([0.1, 0.5, 0.0])
    # sitting: the thigh points ahead
    ahead = np.array([[np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]])
    push = push_of_thigh(np.full(CIRCLES, 0.1), 0.04, Segment(hip, hip[None], ahead), knee)
    moved = push(np.array([[[0.1, 0.98, 0.2], [0.1, 1.2, 0.2], [0.1, 0.98, 0.6]]]))[0]
    np.testing.assert_allclose(moved, [(0.0, 0.06, 0.0), (0, 0, 0), (0, 0, 0)], atol=1e-6)


def test_an_arm_is_swung_out_and_keeps_its_length() -> None:
    rng = np.random.default_rng(4)
    frames = 200
    shoulders = np.tile([[0.2, 1.4, 0.0], [-0.2, 1.4, 0.0]], (frames, 1, 1))
    elbows, wrists = (
        at + length * (v := rng.normal(size=(frames, 2, 3))) / np.linalg.norm(v, axis=-1, keepdims=True)
        for at, length in ((shoulders, 0.28), (0.0, 0.25))
    )
    wrists = elbows + wrists
    still = np.tile(IDENTITY, (frames, 1))
    pelvis, chest = (Segment(np.array([0, y, 0]), np.tile([0, y, 0], (frames, 1)), still) for y in (0.9, 1.3))
    push = push_of_trunk(round_trunk(0.2), pelvis, chest)
    new_elbows, new_wrists = clear_arms([push], shoulders, elbows, wrists, wrists)
    np.testing.assert_allclose(np.linalg.norm(new_elbows - shoulders, axis=-1), 0.28, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(new_wrists - new_elbows, axis=-1), 0.25, atol=1e-9)
    inside = [np.linalg.norm(push(points), axis=-1) for points in (elbows, wrists, new_elbows, new_wrists)]
    assert sum(each.sum() for each in inside[2:]) < 0.2 * sum(each.sum() for each in inside[:2])
    clear = np.all([each == 0 for each in inside[:2]], axis=0)
    between = push(((elbows + wrists) / 2).reshape(frames, 2, 3))
    clear &= ~between.any(axis=-1)
    assert clear.any()
    np.testing.assert_allclose(new_wrists[clear], wrists[clear], atol=1e-12)
    far = elbows + 5
    assert clear_arms([push], shoulders + 5, far, wrists + 5, wrists + 5)[0] is far
