"""A user's BVH files become joints in metres, against matrices of the tests' own."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINT_NAMES, canonicalise
from kinegraph_training.data.body import guess_unit
from kinegraph_training.data.bvh import joint_positions, parse_bvh, resample_bvh
from kinegraph_training.data.naming import NAMING_CONVENTIONS, plain_name
from kinegraph_training.data.retargeting import find_joint_map, map_joints, read_map
from support.bvh_files import MIXAMO, bvh_text, prepare_joints
from support.shared import shared_path


@pytest.mark.parametrize("order", ["".join(axes) for axes in permutations("XYZ")])
def test_every_rotation_order(tmp_path: Path, order: str) -> None:
    text, places = bvh_text(orders=(order,))
    np.testing.assert_allclose(prepare_joints(tmp_path, text), canonicalise(places / 100), atol=1e-5)


def test_orders_that_differ_per_joint_and_positions_that_replace_offsets(tmp_path: Path) -> None:
    text, places = bvh_text(orders=("ZXY", "XYZ", "YZX", "ZYX"), positions_everywhere=True)
    np.testing.assert_allclose(prepare_joints(tmp_path, text), canonicalise(places / 100), atol=1e-5)


def test_clips_start_ahead_at_the_origin_on_the_floor(tmp_path: Path) -> None:
    joints = prepare_joints(tmp_path, bvh_text()[0])
    across = joints[0, 2] - joints[0, 1] + joints[0, 17] - joints[0, 16]
    assert across[0] < 0
    assert across[2] == pytest.approx(0.0, abs=1e-5)
    np.testing.assert_allclose(joints[0, 0, [0, 2]], 0.0, atol=1e-6)
    assert joints[..., 1].min() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_other_frame_rates_are_resampled(tmp_path: Path, fps: float) -> None:
    text, _ = bvh_text(frames=int(2 * fps) + 1, fps=fps)
    _, slow = bvh_text(frames=41, fps=20.0)
    joints = prepare_joints(tmp_path, text)
    assert joints.shape == (41, 22, 3)
    np.testing.assert_allclose(joints, canonicalise(slow / 100), atol=3e-3)


def test_resampling_goes_the_short_way_past_half_a_turn() -> None:
    head = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Yrotation\nEnd Site\n{\nOFFSET 0 0 1\n}\n}\n"
    motion = parse_bvh(head + "MOTION\nFrames: 2\nFrame Time: 0.1\n170\n-170\n")
    ends = joint_positions(resample_bvh(motion, 20.0))[:, 1]
    angles = np.degrees(np.arctan2(ends[:, 0], ends[:, 2])) % 360
    np.testing.assert_allclose(angles, [170, 180, 190], atol=1e-6)


def test_frames_that_fit_are_kept_as_they_are() -> None:
    motion = parse_bvh(bvh_text(frames=60)[0])
    same = resample_bvh(motion, 20.0)
    np.testing.assert_allclose(joint_positions(same), joint_positions(motion), atol=1e-9)
    assert len(resample_bvh(parse_bvh(bvh_text(frames=60, fps=60)[0]), 20.0).positions) == 20


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001, 0.0254, 0.0254 / 0.45])
def test_the_unit_is_guessed_from_the_legs(unit: float) -> None:
    _, places = bvh_text(frames=2)
    assert guess_unit(places / 100 / unit) == unit


def test_a_body_of_no_known_unit_needs_scale(tmp_path: Path) -> None:
    text, places = bvh_text(positions_everywhere=True)
    with pytest.raises(InvalidInputError, match=r"--scale 7$"):
        guess_unit(places / 81 * 0.85 / 7)
    np.testing.assert_allclose(prepare_joints(tmp_path, text, scale=0.0125), canonicalise(places / 80), atol=1e-5)


def test_z_up(tmp_path: Path) -> None:
    text, places = bvh_text()
    turned = text.replace("ROOT Hips", "ROOT World\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\nJOINT Hips", 1)
    head, motion = turned.split("MOTION\n")
    first, second, *rows = motion.splitlines()
    turned = head + "}\nMOTION\n" + "\n".join([first, second, *(f"90 {row}" for row in rows)]) + "\n"
    np.testing.assert_allclose(prepare_joints(tmp_path, turned, up="z"), canonicalise(places / 100), atol=1e-5)


NAMINGS: dict[str, Callable[[str], str]] = {
    "mixamorig:": lambda name: f"mixamorig:{name}",
    "mixamorig1:": lambda name: f"mixamorig1:{name}",
    "bare prefix": lambda name: f"mixamorig{name}",
    "lower": str.lower,
    "LaFAN1": lambda name: name.replace("ToeBase", "Toe"),
    "CMU": lambda name: {"Spine": "LowerBack", "Spine1": "Spine", "Spine2": "Spine1"}.get(name, name),
}


@pytest.mark.parametrize("naming", NAMINGS)
def test_names_of_other_sources(tmp_path: Path, naming: str) -> None:
    text, places = bvh_text([NAMINGS[naming](name) for name in MIXAMO])
    joints = prepare_joints(tmp_path, text)
    # The made-up motion depends on the length of the first name.
    np.testing.assert_allclose(joints, canonicalise(places / 100), atol=1e-5)


@pytest.mark.parametrize(
    "names",
    [
        JOINT_NAMES,
        [f"L_{n[5:]}" if n[:5] == "left_" else f"R_{n[6:]}" if n[:6] == "right_" else n for n in JOINT_NAMES],
        [name.replace("_", "").upper() for name in JOINT_NAMES],
    ],
)
def test_smpl_names(tmp_path: Path, names: list[str]) -> None:
    text, places = bvh_text(names)
    np.testing.assert_allclose(prepare_joints(tmp_path, text), canonicalise(places / 100), atol=1e-5)


def bones_of(source: dict[str, object]) -> tuple[str, ...]:
    return tuple(bone["name"] for bone in source["bones"])  # type: ignore[attr-defined]


@pytest.mark.parametrize("key", ["bandai", "cmu"])
def test_maps_agree_with_those_of_the_data(key: str) -> None:
    path = shared_path("data", "skeletons.json")
    source = json.loads(path.read_text())[key]
    sources = find_joint_map(bones_of(source)).sources
    expected = {joint: name for joint, name in source["map_to_22"].items() if "midpoint" not in name}
    assert dict(sources) == expected


def test_missing_spine_joints_lie_between_their_neighbours(tmp_path: Path) -> None:
    text, places = bvh_text(orders=("ZXY",))
    fewer = text.replace("JOINT Spine2", "JOINT Breast").replace("JOINT Spine1", "JOINT Belly")
    fewer = fewer.replace("JOINT LeftShoulder", "JOINT x").replace("JOINT RightShoulder", "JOINT y")
    joints = prepare_joints(tmp_path, fewer) - prepare_joints(tmp_path, text)[0, 0]
    at = {name: joints[:, index] for index, name in enumerate(JOINT_NAMES)}
    for below, joint, above in (("pelvis", "spine2", "neck"), ("neck", "left_collar", "left_shoulder")):
        whole = np.linalg.norm(at[above] - at[below], axis=-1)
        parts = np.linalg.norm(at[joint] - at[below], axis=-1) + np.linalg.norm(at[above] - at[joint], axis=-1)
        assert (parts <= 1.1 * whole).all()
        assert (parts >= whole - 1e-5).all()
    assert places.shape == (30, 22, 3)


def test_bandai_spine_is_half_way() -> None:
    limbs = NAMING_CONVENTIONS["Bandai Namco"]
    names = tuple(name[0] for joint, name in limbs.items())
    places = np.random.default_rng(0).normal(size=(3, len(names), 3))
    joints = map_joints(places, names, find_joint_map(names))
    np.testing.assert_allclose(joints[:, 3], (joints[:, 0] + joints[:, 6]) / 2)
    np.testing.assert_allclose(joints[:, 0], places[:, names.index("hips")])


def test_a_map_file_goes_before_the_tables(tmp_path: Path) -> None:
    text, places = bvh_text()
    (tmp_path / "map.json").write_text(json.dumps({"head": ["Neck", "HEAD", 0.5], "left_foot": "LeftToeBase.end"}))
    joints = prepare_joints(tmp_path, text, joint_sources=read_map(tmp_path / "map.json"))
    plain = prepare_joints(tmp_path, text)
    head, neck, foot = JOINT_NAMES.index("head"), JOINT_NAMES.index("neck"), JOINT_NAMES.index("left_foot")
    lowered = joints[:, neck] - plain[:, neck]
    np.testing.assert_allclose(joints[:, head] - lowered, (plain[:, head] + plain[:, neck]) / 2, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(joints[:, foot] - lowered - plain[:, foot], axis=-1), 0.05, atol=1e-4)
    assert places.shape == joints.shape


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('{"pelvis": "Hips"', "no JSON"),
        ('["Hips"]', "object"),
        ('{"tail": "Hips"}', "tail.*pelvis"),
        ('{"pelvis": 3}', "pelvis is 3"),
        ('{"pelvis": ["Hips", "Spine"]}', "pelvis"),
        ('{"pelvis": ["Hips", "Spine", true]}', "pelvis"),
    ],
)
def test_bad_map_files(tmp_path: Path, entry: str, message: str) -> None:
    (tmp_path / "map.json").write_text(entry)
    with pytest.raises(InvalidInputError, match=message):
        read_map(tmp_path / "map.json")
    with pytest.raises(InvalidInputError, match=r"absent\.json"):
        read_map(tmp_path / "absent.json")


def test_joints_that_cannot_be_mapped_are_named(tmp_path: Path) -> None:
    text = bvh_text()[0].replace("JOINT LeftForeArm", "JOINT Tentacle").replace("JOINT Head", "JOINT Top")
    with pytest.raises(
        InvalidInputError, match=r"one\.bvh: no joint found for head, left_elbow .*Mixamo.*Tentacle.*--map"
    ):
        prepare_joints(tmp_path, text)
    with pytest.raises(InvalidInputError, match="takes left_elbow from 'Arm', which the file lacks"):
        prepare_joints(tmp_path, text, joint_sources={"left_elbow": "Arm"})
    assert prepare_joints(tmp_path, text, joint_sources={"left_elbow": "tentacle", "head": "Top"}).shape == (30, 22, 3)


def test_plain_names() -> None:
    for name in ("mixamorig:LeftUpLeg", "leftupleg", "L_UpLeg_JNT", "Hero|Character1_LeftUpLeg", "upleg.L", "UPLEGL"):
        assert plain_name(name) == "left upleg"
    for name in ("LowerBack", "Bip01 lowerback", "robot_LowerBack"):
        assert plain_name(name) == "lowerback"
    assert plain_name("CC_Base_L_Thigh") == "left thigh"
    assert plain_name("rig:spine:Left Foot.end") == "left foot.end"
    assert plain_name("Bip01_Neck") == "neck"
