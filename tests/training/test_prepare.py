"""A user's BVH files and captions -> training data, against matrices of the tests' own; faults by name."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from kinegraph.errors import InvalidInputError, OutputError
from kinegraph.motion.clip import Clip
from kinegraph.motion.placement import placed
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS
from kinegraph_training.bvh_reader import joint_positions, parse_bvh, read_bvh, resampled
from kinegraph_training.captions_file import matched, read_captions
from kinegraph_training.data import read_split
from kinegraph_training.data_writer import split_of
from kinegraph_training.joint_map import TABLES, joint_map, mapped, plain_name, read_map
from kinegraph_training.prepare import PrepareOptions, clip_joints, main, prepare, unit_of

SHARED = Path(__file__).resolve().parents[3] / "shared"

# Offsets in centimetres, facing +Z, in the order of the 22 joints.
OFFSETS = np.array(
    [
        *((0, 95, 0), (10, -8, 0), (-10, -8, 0), (0, 10, -1), (0, -40, 0), (0, -40, 0), (0, 13, 0)),
        *((0, -41, 0), (0, -41, 0), (0, 6, 2), (0, -6, 12), (0, -6, 12), (0, 21, -3), (7, 12, -2)),
        *(
            (-7, 12, -2),
            (0, 10, 4),
            (12, 4, 0),
            (-12, 4, 0),
            (26, 0, 0),
            (-26, 0, 0),
            (25, 0, 0),
            (-25, 0, 0),
        ),
    ],
    dtype=np.float64,
)
MIXAMO = (
    *("Hips", "LeftUpLeg", "RightUpLeg", "Spine", "LeftLeg", "RightLeg", "Spine1", "LeftFoot", "RightFoot"),
    *("Spine2", "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder", "Head", "LeftArm"),
    *("RightArm", "LeftForeArm", "RightForeArm", "LeftHand", "RightHand"),
)


def turn(axis: str, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    rows = {
        "X": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "Y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "Z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return np.array(rows[axis], dtype=np.float64)


def bvh_text(
    names: Sequence[str] = MIXAMO,
    *,
    orders: Sequence[str] = ("ZXY",),
    frames: int = 30,
    fps: float = 20.0,
    positions_everywhere: bool = False,
) -> tuple[str, np.ndarray]:
    """A file of smooth made-up motion, and its joints (frames, 22, 3) in centimetres by matrices."""
    rng = np.random.default_rng(len(names[0]))
    size, phase = rng.uniform(5, 25, (22, 3)), rng.uniform(0, 6, (22, 3))
    moments = np.arange(frames) / fps
    degrees = size * np.sin(2.0 * moments[:, None, None] + phase)
    root = np.stack([40 * moments, 95 + 2 * np.sin(5 * moments), 80 * moments], axis=-1)
    order_of = [orders[joint % len(orders)] for joint in range(22)]
    with_position = [joint == 0 or positions_everywhere for joint in range(22)]

    def lines(joint: int) -> list[str]:
        children = [child for child in range(22) if PARENTS[child] == joint]
        rotations = [f"{axis}rotation" for axis in order_of[joint]]
        channels = (["Xposition", "Yposition", "Zposition"] if with_position[joint] else []) + rotations
        # Where position channels replace it, the OFFSET must not count.
        offset = (1, 2, 3) if with_position[joint] else OFFSETS[joint]
        return [
            f"{'JOINT' if joint else 'ROOT'} {names[joint]}",
            "{",
            "OFFSET " + " ".join(str(value) for value in offset),
            f"CHANNELS {len(channels)} {' '.join(channels)}",
            *(line for child in children for line in lines(child)),
            *([] if children else ["End Site", "{", "OFFSET 0 0 5", "}"]),
            "}",
        ]

    def depth_first(joint: int) -> list[int]:
        return [joint, *(j for child in range(22) if PARENTS[child] == joint for j in depth_first(child))]

    rows, places = [], np.zeros((frames, 22, 3))
    for frame in range(frames):
        numbers: list[float] = []
        for joint in depth_first(0):
            numbers += list(root[frame] if joint == 0 else OFFSETS[joint]) if with_position[joint] else []
            numbers += list(degrees[frame, joint])
        rows.append(" ".join(f"{number:.9f}" for number in numbers))
        axes: list[np.ndarray] = []
        for joint, parent in enumerate(PARENTS):
            own = np.eye(3)
            for axis, angle in zip(order_of[joint], degrees[frame, joint], strict=True):
                own = own @ turn(axis, np.radians(angle))
            axes.append(own if parent < 0 else axes[parent] @ own)
            places[frame, joint] = root[frame] if parent < 0 else places[frame, parent] + axes[parent] @ OFFSETS[joint]
    motion = ["MOTION", f"Frames: {frames}", f"Frame Time: {1 / fps:.8f}", *rows]
    return "\n".join(["HIERARCHY", *lines(0), *motion]) + "\n", places


def folder_of(tmp_path: Path, files: dict[str, str], captions: dict[str, str] | None = None) -> list[str]:
    """A folder of files with captions; the arguments that prepare them."""
    for name, text in files.items():
        path = tmp_path / "bvh" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    told = captions if captions is not None else dict.fromkeys(files, "a person moves")
    (tmp_path / "c.csv").write_text("file,caption\n" + "".join(f"{k},{v}\n" for k, v in told.items()))
    return [
        "--bvh",
        str(tmp_path / "bvh"),
        "--captions",
        str(tmp_path / "c.csv"),
        "--out",
        str(tmp_path / "out"),
    ]


def prepared(tmp_path: Path, text: str, **options: object) -> np.ndarray:
    path = tmp_path / "one.bvh"
    path.write_text(text)
    return clip_joints(path, PrepareOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize("order", ["".join(axes) for axes in permutations("XYZ")])
def test_every_rotation_order(tmp_path: Path, order: str) -> None:
    text, places = bvh_text(orders=(order,))
    np.testing.assert_allclose(prepared(tmp_path, text), placed(places / 100), atol=1e-5)


def test_orders_that_differ_per_joint_and_positions_that_replace_offsets(tmp_path: Path) -> None:
    text, places = bvh_text(orders=("ZXY", "XYZ", "YZX", "ZYX"), positions_everywhere=True)
    np.testing.assert_allclose(prepared(tmp_path, text), placed(places / 100), atol=1e-5)


def test_clips_start_ahead_at_the_origin_on_the_floor(tmp_path: Path) -> None:
    joints = prepared(tmp_path, bvh_text()[0])
    across = joints[0, 2] - joints[0, 1] + joints[0, 17] - joints[0, 16]
    assert across[0] < 0
    assert across[2] == pytest.approx(0.0, abs=1e-5)
    np.testing.assert_allclose(joints[0, 0, [0, 2]], 0.0, atol=1e-6)
    assert joints[..., 1].min() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_other_frame_rates_are_resampled(tmp_path: Path, fps: float) -> None:
    text, _ = bvh_text(frames=int(2 * fps) + 1, fps=fps)
    _, slow = bvh_text(frames=41, fps=20.0)
    joints = prepared(tmp_path, text)
    assert joints.shape == (41, 22, 3)
    np.testing.assert_allclose(joints, placed(slow / 100), atol=3e-3)


def test_resampling_goes_the_short_way_past_half_a_turn() -> None:
    head = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Yrotation\nEnd Site\n{\nOFFSET 0 0 1\n}\n}\n"
    motion = parse_bvh(head + "MOTION\nFrames: 2\nFrame Time: 0.1\n170\n-170\n")
    ends = joint_positions(resampled(motion, 20.0))[:, 1]
    angles = np.degrees(np.arctan2(ends[:, 0], ends[:, 2])) % 360
    np.testing.assert_allclose(angles, [170, 180, 190], atol=1e-6)


def test_frames_that_fit_are_kept_as_they_are() -> None:
    motion = parse_bvh(bvh_text(frames=60)[0])
    same = resampled(motion, 20.0)
    np.testing.assert_allclose(joint_positions(same), joint_positions(motion), atol=1e-9)
    assert len(resampled(parse_bvh(bvh_text(frames=60, fps=60)[0]), 20.0).positions) == 20


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001, 0.0254, 0.0254 / 0.45])
def test_the_unit_is_guessed_from_the_legs(unit: float) -> None:
    _, places = bvh_text(frames=2)
    assert unit_of(places / 100 / unit) == unit


def test_a_body_of_no_known_unit_needs_scale(tmp_path: Path) -> None:
    text, places = bvh_text(positions_everywhere=True)
    with pytest.raises(InvalidInputError, match=r"--scale 7$"):
        unit_of(places / 81 * 0.85 / 7)
    np.testing.assert_allclose(prepared(tmp_path, text, scale=0.0125), placed(places / 80), atol=1e-5)


def test_z_up(tmp_path: Path) -> None:
    text, places = bvh_text()
    turned = text.replace("ROOT Hips", "ROOT World\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\nJOINT Hips", 1)
    head, motion = turned.split("MOTION\n")
    first, second, *rows = motion.splitlines()
    turned = head + "}\nMOTION\n" + "\n".join([first, second, *(f"90 {row}" for row in rows)]) + "\n"
    np.testing.assert_allclose(prepared(tmp_path, turned, up="z"), placed(places / 100), atol=1e-5)


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
    joints = prepared(tmp_path, text)
    # The made-up motion depends on the length of the first name.
    np.testing.assert_allclose(joints, placed(places / 100), atol=1e-5)


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
    np.testing.assert_allclose(prepared(tmp_path, text), placed(places / 100), atol=1e-5)


def bones_of(source: dict[str, object]) -> tuple[str, ...]:
    return tuple(bone["name"] for bone in source["bones"])  # type: ignore[attr-defined]


@pytest.mark.parametrize("key", ["bandai", "cmu"])
def test_maps_agree_with_those_of_the_data(key: str) -> None:
    path = SHARED / "data" / "skeletons.json"
    if not path.is_file():
        pytest.skip("the data's own maps (../shared/data) are not at hand")
    source = json.loads(path.read_text())[key]
    found = joint_map(bones_of(source)).sources
    expected = {joint: name for joint, name in source["map_to_22"].items() if "midpoint" not in name}
    assert dict(found) == expected


def test_missing_spine_joints_lie_between_their_neighbours(tmp_path: Path) -> None:
    text, places = bvh_text(orders=("ZXY",))
    fewer = text.replace("JOINT Spine2", "JOINT Breast").replace("JOINT Spine1", "JOINT Belly")
    fewer = fewer.replace("JOINT LeftShoulder", "JOINT x").replace("JOINT RightShoulder", "JOINT y")
    joints = prepared(tmp_path, fewer) - prepared(tmp_path, text)[0, 0]
    at = {name: joints[:, index] for index, name in enumerate(JOINT_NAMES)}
    for below, joint, above in (("pelvis", "spine2", "neck"), ("neck", "left_collar", "left_shoulder")):
        whole = np.linalg.norm(at[above] - at[below], axis=-1)
        parts = np.linalg.norm(at[joint] - at[below], axis=-1) + np.linalg.norm(at[above] - at[joint], axis=-1)
        assert (parts <= 1.1 * whole).all()
        assert (parts >= whole - 1e-5).all()
    assert places.shape == (30, 22, 3)


def test_bandai_spine_is_half_way() -> None:
    limbs = TABLES["Bandai Namco"]
    names = tuple(name[0] for joint, name in limbs.items())
    places = np.random.default_rng(0).normal(size=(3, len(names), 3))
    joints = mapped(places, names, joint_map(names))
    np.testing.assert_allclose(joints[:, 3], (joints[:, 0] + joints[:, 6]) / 2)
    np.testing.assert_allclose(joints[:, 0], places[:, names.index("hips")])


def test_a_map_file_goes_before_the_tables(tmp_path: Path) -> None:
    text, places = bvh_text()
    (tmp_path / "map.json").write_text(json.dumps({"head": ["Neck", "HEAD", 0.5], "left_foot": "LeftToeBase.end"}))
    joints = prepared(tmp_path, text, own_map=read_map(tmp_path / "map.json"))
    plain = prepared(tmp_path, text)
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
        prepared(tmp_path, text)
    with pytest.raises(InvalidInputError, match="takes left_elbow from 'Arm', which the file lacks"):
        prepared(tmp_path, text, own_map={"left_elbow": "Arm"})
    assert prepared(tmp_path, text, own_map={"left_elbow": "tentacle", "head": "Top"}).shape == (30, 22, 3)


def test_plain_names() -> None:
    assert plain_name("mixamorig:LeftUpLeg") == "leftupleg"
    assert plain_name("CC_Base_L_Thigh") == "lthigh"
    assert plain_name("rig:spine:Left Foot.end") == "leftfoot.end"
    assert plain_name("Bip01_Neck") == "neck"


GOOD = bvh_text()[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no BVH file"),
        ("HIERARCHY\nROOT a\n", "no BVH file"),
        (GOOD.replace("HIERARCHY", "HIERACHY"), "no BVH file"),
        (GOOD.replace("ROOT Hips", "RUT Hips"), "outside of every joint|no line"),
        (GOOD.replace("OFFSET", "OFSET", 1), "OFSET"),
        (GOOD.replace("OFFSET 1 2 3", "OFFSET 1 2"), "OFFSET of 'Hips'.*three numbers"),
        (GOOD.replace("OFFSET 1 2 3", "OFFSET 1 nan 3"), "OFFSET of 'Hips'.*finite"),
        (GOOD.replace("OFFSET 1 2 3\n", ""), "'Hips' has no OFFSET"),
        (GOOD.replace("CHANNELS 6", "CHANNELS 5"), "CHANNELS of 'Hips'"),
        (GOOD.replace("Zrotation", "Wrotation", 1), "CHANNELS of 'Hips'"),
        (GOOD.replace("Zrotation", "Yrotation", 1), "CHANNELS of 'Hips'"),
        (GOOD.replace("}\nMOTION", "MOTION"), "cut short"),
        (GOOD.replace("Frames: 30", "Frames: 31"), "31 frames of 69 channels are 2139 numbers.*2070"),
        (GOOD.replace("Frames: 30", "Frames: 0"), "above 0"),
        (GOOD.replace("Frames: 30", "Frames: many"), "Frames: N"),
        (GOOD.replace("Frame Time: 0.05", "Frame Time: -0.05"), "above 0"),
        (GOOD[: len(GOOD) // 2 * 2 - 400], "cut short"),
        (GOOD.rpartition(" ")[0] + " nan\n", "not finite"),
        (GOOD.replace("95.", "95,"), "numbers only"),
    ],
)
def test_broken_files_are_refused_by_name(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=rf"one\.bvh: .*({message})"):
        prepared(tmp_path, text)


def test_a_clip_of_one_frame_or_far_too_large_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="two frames"):
        prepared(tmp_path, bvh_text(frames=1)[0])
    with pytest.raises(InvalidInputError, match=r"3\.2 m"):
        prepared(tmp_path, GOOD, scale=1.0)
    with pytest.raises(InvalidInputError, match=r"absent\.bvh"):
        read_bvh(tmp_path / "absent.bvh")


def test_a_joint_may_be_called_motion() -> None:
    motion = parse_bvh(GOOD.replace("ROOT Hips", "ROOT MOTION Hips").replace("\n", "\r\n"))
    assert motion.names[0] == "MOTION Hips"
    assert "Head.end" in motion.names


def test_a_folder_becomes_training_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {f"{'walks/' if n % 2 else ''}clip{n}.bvh": bvh_text(frames=20 + n) for n in range(12)}
    arguments = folder_of(tmp_path, {name: text for name, (text, _) in files.items()})
    assert main([*arguments, "--val", "0.2", "--test", "0.2"]) == 0
    assert "12 clips" in capsys.readouterr().out
    clips = {clip.id: clip for split in ("train", "val", "test") for clip in read_split(tmp_path / "out", split)}
    assert sorted(clips) == sorted(name.removesuffix(".bvh") for name in files)
    for name, (_, places) in files.items():
        clip = clips[name.removesuffix(".bvh")]
        assert clip.captions == ("a person moves",)
        np.testing.assert_allclose(clip.joints, placed(places / 100), atol=1.5e-4)
    index = [json.loads(line) for line in (tmp_path / "out" / "index.jsonl").read_text().splitlines()]
    assert index[0] == {
        "id": "clip0",
        "frames": 20,
        "fps": 20,
        "source_file": "clip0.bvh",
        "split": index[0]["split"],
    }
    assert {row["split"] for row in index} == {"train", "val", "test"}
    for split in ("train", "val", "test"):
        ids = [row["id"] for row in index if row["split"] == split]
        assert ids == [clip.id for clip in read_split(tmp_path / "out", split)]
    with np.load(tmp_path / "out" / "train.npz", allow_pickle=False) as pack:
        assert pack["joints"].dtype == np.int16
        assert pack["root_xz"].dtype == np.float32
        assert pack["fps"] == 20
        assert pack["offsets"][-1] == len(pack["joints"]) == len(pack["root_xz"])
        assert not pack["joints"][:, 0, [0, 2]].any()


def test_our_own_files_come_back(tmp_path: Path) -> None:
    path = SHARED / "data" / "bandai" / "val.npz"
    if not path.is_file():
        pytest.skip("recorded motion (../shared/data) is not at hand")
    for clip in read_split(path.parent, "val")[::16]:
        saved = Clip(joints=clip.joints, fps=20.0, seed=0, text="x", bundle="b")
        saved.save(tmp_path / f"{clip.id}.bvh")
        back = clip_joints(tmp_path / f"{clip.id}.bvh", PrepareOptions())
        assert np.linalg.norm(back - placed(clip.joints), axis=-1).max() <= 2e-3


def test_a_made_up_clip_of_our_own_comes_back(tmp_path: Path) -> None:
    _, places = bvh_text(frames=40)
    joints = placed(places / 100)
    Clip(joints=joints, fps=60.0, seed=0, text="x", bundle="b").save(tmp_path / "x.bvh")
    back = clip_joints(tmp_path / "x.bvh", PrepareOptions(fps=60.0))
    assert np.linalg.norm(back - joints, axis=-1).max() <= 2e-3


def test_splits_depend_on_the_name_alone() -> None:
    ids = [f"clip{number}" for number in range(2000)]
    splits = split_of(ids, val=0.1, test=0.05)
    counts = {split: sum(each == split for each in splits.values()) for split in ("train", "val", "test")}
    assert 150 < counts["val"] < 250
    assert 60 < counts["test"] < 140
    fewer = split_of(ids[::2], val=0.1, test=0.05)
    assert all(splits[each] == fewer[each] for each in fewer)


def test_small_data_still_gets_a_validation_clip() -> None:
    assert sorted(split_of(["a", "b", "c"], val=0.001, test=0.001).values()) == ["test", "train", "val"]
    assert split_of(["a"], val=0.05, test=0.05) == {"a": "train"}
    assert set(split_of(["a", "b"], val=0.0, test=0.0).values()) == {"train"}


def write(tmp_path: Path, name: str, text: str) -> Path:
    (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path / name


def test_captions_of_all_kinds(tmp_path: Path) -> None:
    expected = {"a.bvh": ("walks, then bows", "bows"), "b": ("runs",)}
    lines = '{"file": "a.bvh", "captions": ["walks, then  bows", "bows"]}\n\n{"file": "b", "caption": "runs"}\n'
    assert read_captions(write(tmp_path, "c.jsonl", lines)) == expected
    rows = '\ufefffile,caption\na.bvh,"walks, then bows"\na.bvh,bows\nb, runs \n'
    assert read_captions(write(tmp_path, "c.csv", rows)) == expected
    tabs = "a.bvh\twalks, then bows\na.bvh\tbows\nb\truns\n"
    assert read_captions(write(tmp_path, "c.tsv", tabs)) == expected


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("c.txt", "a,b", r"\.jsonl, \.csv, \.tsv"),
        ("c.csv", "", "no captions"),
        ("c.csv", "file,caption\na.bvh,walks, then bows\n", "line 2: 3 columns"),
        ("c.csv", "a.bvh,\n", "line 1: the caption ''"),
        ("c.csv", "a.bvh,!!!\n", "must have words"),
        ("c.csv", f"a.bvh,{'x' * 513}\n", "512 characters"),
        ("c.csv", ",walks\n", "no file is named"),
        ("c.jsonl", "{", "line 1: no JSON"),
        ("c.jsonl", '{"file": "a"}', "line 1: must be"),
        ("c.jsonl", '{"file": "a", "captions": []}', "line 1: must be"),
        ("c.jsonl", '{"file": "a", "captions": ["x", 3]}', "line 1: must be"),
        ("c.jsonl", '{"file": 3, "captions": ["x"]}', "line 1: must be"),
    ],
)
def test_bad_captions_files(tmp_path: Path, name: str, text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        read_captions(write(tmp_path, name, text))


def test_captions_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_bytes(b"a.bvh,caf\xe9\n")
    for name in ("c.csv", "absent.csv"):
        with pytest.raises(InvalidInputError, match=name):
            read_captions(tmp_path / name)


def test_captions_find_their_files() -> None:
    captions = {"deep/a.BVH": ("x",), "b": ("y",), ".\\deep\\c.bvh": ("z",), "a": ("w",), "b.bvh": ("v",)}
    assert matched(captions, ["deep/a", "deep/b", "deep/c"]) == {
        "deep/a": ("x", "w"),
        "deep/b": ("y", "v"),
        "deep/c": ("z",),
    }
    with pytest.raises(InvalidInputError, match=r"captions without a BVH file: d.*BVH files without a caption: a, b"):
        matched({"d": ("x",)}, ["b", "a"])
    with pytest.raises(InvalidInputError, match=r"a\.bvh \(which of one/a, two/a\?\)"):
        matched({"a.bvh": ("x",), "one/a": ("y",), "two/a": ("z",)}, ["one/a", "two/a"])


@pytest.mark.parametrize(
    ("files", "captions", "extra", "message"),
    [
        ({"a.bvh": GOOD, "b.bvh": "junk"}, None, [], "b.bvh: no BVH file"),
        ({"a.bvh": GOOD}, {"a.bvh": "x", "z.bvh": "y"}, [], "captions without a BVH file: z.bvh"),
        ({"a.bvh": GOOD, "b.bvh": GOOD}, {"a.bvh": "x"}, [], "without a caption: b"),
        ({"a.bvh": GOOD, "a.BVH": GOOD}, None, [], "same id"),
        ({"a.txt": GOOD}, None, [], "no .bvh files"),
        ({"a.bvh": GOOD}, None, ["--fps", "0"], "--fps"),
        ({"a.bvh": GOOD}, None, ["--fps", "1e9"], "--fps"),
        ({"a.bvh": GOOD}, None, ["--fps", "nan"], "--fps"),
        ({"a.bvh": GOOD}, None, ["--scale", "-1"], "--scale"),
        ({"a.bvh": GOOD}, None, ["--val", "0.6", "--test", "0.5"], "--val"),
        ({"a.bvh": GOOD}, None, ["--val", "nan"], "--val"),
        ({"a.bvh": GOOD}, None, ["--map", "absent.json"], "absent.json"),
        ({"a.bvh": "junk"}, None, ["--skip-broken"], "a.bvh"),
    ],
)
def test_the_command_line_says_what_is_wrong_and_writes_nothing(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    files: dict[str, str],
    captions: dict[str, str] | None,
    extra: list[str],
    message: str,
) -> None:
    assert main([*folder_of(tmp_path, files, captions), *extra]) == 2
    error = capsys.readouterr().err
    assert error.count("error:") == 1
    assert message in error
    assert not (tmp_path / "out").exists()


def test_broken_files_can_be_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = folder_of(tmp_path, {"a.bvh": GOOD, "b.bvh": "junk", "c.bvh": GOOD})
    assert main([*arguments, "--skip-broken", "--val", "0", "--test", "0"]) == 0
    assert "left out" in capsys.readouterr().err
    assert [clip.id for clip in read_split(tmp_path / "out", "train")] == ["a", "c"]
    assert read_split(tmp_path / "out", "val") == []


def test_data_is_not_overwritten_unless_asked(tmp_path: Path) -> None:
    arguments = folder_of(tmp_path, {"a.bvh": GOOD, "b.bvh": GOOD})
    paths = [tmp_path / "bvh", tmp_path / "c.csv", tmp_path / "out"]
    prepare(*paths, PrepareOptions())
    before = (tmp_path / "out" / "index.jsonl").read_bytes()
    (tmp_path / "bvh" / "b.bvh").write_text(bvh_text(frames=9)[0])
    with pytest.raises(OutputError, match="--force"):
        prepare(*paths, PrepareOptions())
    assert (tmp_path / "out" / "index.jsonl").read_bytes() == before
    assert main([*arguments, "--force"]) == 0
    assert (tmp_path / "out" / "index.jsonl").read_bytes() != before
    with pytest.raises(OutputError, match="is a file"):
        prepare(tmp_path / "bvh", tmp_path / "c.csv", tmp_path / "c.csv", PrepareOptions())
    with pytest.raises(InvalidInputError, match="no folder"):
        prepare(tmp_path / "absent", tmp_path / "c.csv", tmp_path / "other", PrepareOptions())
