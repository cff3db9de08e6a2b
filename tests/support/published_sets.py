"""Made folders of exactly the layouts in which HumanML3D, KIT-ML, BONES-SEED and AMASS are published."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, JOINTS, PARENTS
from support.exporters import METRES, euler, names_of, rest_along_x, true_motion

SOMA = {
    name: joint
    for joint, name in names_of(
        "Hips Spine1 Spine2 Chest Neck1 Head", "Leg Shin Foot ToeBase Shoulder Arm ForeArm Hand"
    ).items()
}
FINGERS = {"Thumb": ("1", "2", "3", "End")} | dict.fromkeys(
    ("Index", "Middle", "Ring", "Pinky"), ("1", "2", "3", "4", "End")
)
CAPTION_COLUMNS = (*(f"content_natural_desc_{n}" for n in range(1, 5)), "content_short_description",
                   "content_short_description_2", "content_technical_description")  # fmt: skip

LINES = """a person walks forward#a/DET person/NOUN walk/VERB forward/ADV#0.0#0.0
someone walks ahead.#someone/PRON walk/VERB ahead/ADV#nan#nan
then the person turns#then/ADV the/DET person/NOUN turn/VERB#2.0#5.0
a figure turns#a/DET figure/NOUN turn/VERB#2.0#5.0
too short to tell#too/ADV short/ADJ#0.0#0.5
"""


def write_guo_set(folder: Path, motions: dict[str, np.ndarray], vectors: dict[str, np.ndarray]) -> Path:
    """Write HumanML3D or KIT-ML as published; the last two names select and test, the others train."""
    for name in ("new_joints", "new_joint_vecs", "texts"):
        (folder / name).mkdir(parents=True)
    for name, array in motions.items():
        np.save(folder / "new_joints" / f"{name}.npy", array)
    for name, array in vectors.items():
        np.save(folder / "new_joint_vecs" / f"{name}.npy", array)
    names = sorted(motions.keys() | vectors.keys())
    for name in names:
        (folder / "texts" / f"{name}.txt").write_text(LINES)
    for split, members in zip(("train", "val", "test"), (names[:-2], names[-2:-1], names[-1:]), strict=True):
        (folder / f"{split}.txt").write_text("\n".join(members) + "\n")
    return folder


def soma_tree() -> list[tuple[str, str]]:
    """The 77 joints of SOMA with their parents, in the order of the files; the root stands above Hips."""
    arms = []
    for side in ("Left", "Right"):
        chain = ("Chest", *(f"{side}{part}" for part in ("Shoulder", "Arm", "ForeArm", "Hand")))
        arms += list(zip(chain[1:], chain, strict=False))
        for finger, joints in FINGERS.items():
            names = [f"{side}Hand", *(f"{side}Hand{finger}{joint}" for joint in joints)]
            arms += list(zip(names[1:], names, strict=False))
    legs = []
    for side in ("Left", "Right"):
        chain = ("Hips", *(f"{side}{part}" for part in ("Leg", "Shin", "Foot", "ToeBase", "ToeEnd")))
        legs += list(zip(chain[1:], chain, strict=False))
    spine = ("Root", "Hips", "Spine1", "Spine2", "Chest", "Neck1", "Neck2", "Head")
    head = [(name, "Head") for name in ("HeadEnd", "Jaw", "LeftEye", "RightEye")]
    return [*zip(spine[1:], spine, strict=False), *head, *arms, *legs]


def soma_bvh(frames: int) -> str:
    """Write the motion of `exporters` as SOMA files have it: 120 a second, bones along X, no End Sites."""
    times = np.arange(frames) / 120.0
    places, axes = true_motion(times)
    rest = rest_along_x()
    axes = axes @ np.swapaxes(rest, -1, -2)
    tree = soma_tree()
    parent_of = dict(tree)
    place = np.zeros((22, 3))
    for joint, parent in enumerate(PARENTS[1:], start=1):
        place[joint] = place[parent] + METRES[joint]
    still = np.tile(np.eye(3), (frames, 1, 1))
    rows: list[np.ndarray] = []

    def ancestor(name: str) -> str:
        while name not in SOMA and name != "Root":
            name = parent_of[name]
        return name

    def block(name: str) -> list[str]:
        joint = JOINT_INDEX[SOMA[name]] if name in SOMA else None
        above = ancestor(parent_of[name]) if name != "Root" else ""
        moving = name in ("Root", "Hips")
        offset = np.zeros(3)
        if joint is not None and above in SOMA:
            upper = JOINT_INDEX[SOMA[above]]
            offset = rest[upper] @ (place[joint] - place[upper]) * 100 * (0.5 if name == "Head" else 1.0)
        elif name == "Neck2":
            neck, head = JOINT_INDEX["neck"], JOINT_INDEX["head"]
            offset = rest[neck] @ (place[head] - place[neck]) * 50
        elif name != "Root":
            offset = np.array([3.0, 0.0, 0.0])
        if moving:
            rows.append(np.zeros((frames, 3)) if name == "Root" else places[:, 0] * 100)
        turned = above if above in SOMA else None
        outer = axes[:, JOINT_INDEX[SOMA[turned]]] if turned else still
        rows.append(
            euler(np.swapaxes(outer, -1, -2) @ axes[:, joint], "ZYX") if joint is not None else np.zeros((frames, 3))
        )
        channels = ("6 Xposition Yposition Zposition" if moving else "3") + " Zrotation Yrotation Xrotation"
        lines = [f"{'ROOT' if name == 'Root' else 'JOINT'} {name}", "{",
                 "OFFSET " + " ".join(f"{value:.6f}" for value in offset), f"CHANNELS {channels}"]  # fmt: skip
        for child, parent in tree:
            if parent == name:
                lines += block(child)
        return [*lines, "}"]

    lines = ["HIERARCHY", *block("Root")]
    numbers = np.concatenate(rows, axis=1)
    motion = [" ".join(f"{value:.6f}" for value in row) for row in numbers]
    return "\n".join([*lines, "MOTION", f"Frames: {frames}", "Frame Time: 0.008333", *motion]) + "\n"


def write_bones_seed(folder: Path, frames: dict[str, int]) -> Path:
    """Write the metadata, the timelines and the motion of recordings named DATE/NAME__A001, and the split files.

    Every second name is in the training split; `_M` names are mirror images.
    """
    rows, labels = [], []
    for name, count in frames.items():
        path = folder / "soma_uniform" / "bvh" / f"{name}.bvh"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(soma_bvh(count))
        file = name.partition("/")[2]
        described = {column: f"{column} of {file.partition('_')[0]}" for column in CAPTION_COLUMNS}
        rows.append(
            {"filename": file, "move_name": file, "move_duration_frames": count, "category": "Baseline",
             "is_mirror": str(file.endswith("_M")), "content_name": file.partition("__")[0],
             "move_soma_uniform_path": f"soma_uniform/bvh/{name}.bvh",
             "move_soma_proportional_path": f"soma_proportional/bvh/{name}.bvh"} | described
        )  # fmt: skip
        seconds = count / 120
        events = [
            (0.0, seconds / 2, "A person starts to walk."),
            (seconds / 2, seconds, "A person walks on, then waves."),
        ]
        told = [{"start_time": round(a, 2), "end_time": round(b, 2), "description": text} for a, b, text in events]
        labels.append({"filename": file, "num_events": 2, "propagated_from_filename": None, "events": told})
    metadata = folder / "metadata"
    metadata.mkdir()
    with (metadata / "seed_metadata_v004.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    (metadata / "seed_metadata_v002_temporal_labels.jsonl").write_text(
        "".join(json.dumps(row) + "\n" for row in labels)
    )
    names = list(frames)
    (folder / "splits").mkdir()
    for file, members in (("train", names[::2]), ("test_content", names[1::4]), ("test_repetition", names[3::4])):
        (folder / "splits" / f"{file}_split_paths.txt").write_text("".join(f"{name}\n" for name in members))
    return folder


def write_body_model(
    folder: Path, kind: str = "smplh", gender: str = "male", vertices: int = 60
) -> dict[str, np.ndarray]:
    """Write a made body model in the published layout, its joints those of the tests' skeleton; returns its arrays."""
    rng = np.random.default_rng(3)
    joints, width = {"smplh": (52, 16), "smplx": (55, 400)}[kind]
    place = np.zeros((22, 3))
    for joint, parent in enumerate(PARENTS[1:], start=1):
        place[joint] = place[parent] + METRES[joint]
    regressor = np.zeros((joints, vertices))
    regressor[np.arange(joints), np.arange(joints)] = 1.0
    template = rng.standard_normal((vertices, 3))
    template[:22] = place
    tree = np.zeros((2, joints), dtype=np.uint32)
    tree[0, :22] = [4294967295, *PARENTS[1:]]
    tree[0, 22:] = 20
    tree[1] = np.arange(joints)
    arrays = {
        "J_regressor": regressor,
        "v_template": template,
        "shapedirs": 0.01 * rng.standard_normal((vertices, 3, width)),
        "kintree_table": tree,
    }
    name = f"{kind}/{gender}/model.npz" if kind == "smplh" else f"{kind}/SMPLX_{gender.upper()}.npz"
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    np.savez(folder / name, **arrays)
    return arrays


def amass_arrays(frames: int, fps: float, kind: str = "smplh", gender: str = "male") -> dict[str, np.ndarray]:
    """Parameters of the motion of `exporters` as AMASS stores them: Z up, axis times angle, shape 0."""
    times = np.arange(frames) / fps
    places, axes = true_motion(times)
    upright = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # Y up -> Z up
    poses = np.zeros((frames, {"smplh": 52, "smplx": 55}[kind], 3))
    for joint in range(JOINTS):
        parent = PARENTS[joint]
        local = upright @ axes[:, 0] if parent < 0 else np.swapaxes(axes[:, parent], -1, -2) @ axes[:, joint]
        poses[:, joint] = axis_angle(local)
    rate = "mocap_framerate" if kind == "smplh" else "mocap_frame_rate"
    return {
        "poses": poses.reshape(frames, -1),
        "trans": places[:, JOINT_NAMES.index("pelvis")] @ upright.T,
        "betas": np.zeros(16),
        "gender": np.array(gender),
        rate: np.array(float(fps)),
    }


def axis_angle(matrices: np.ndarray) -> np.ndarray:
    """Axis times angle (k, 3) of rotation matrices (k, 3, 3) of less than half a turn."""
    angle = np.arccos(np.clip((np.trace(matrices, axis1=1, axis2=2) - 1) / 2, -1, 1))
    skew = np.stack([matrices[:, 2, 1] - matrices[:, 1, 2], matrices[:, 0, 2] - matrices[:, 2, 0],
                     matrices[:, 1, 0] - matrices[:, 0, 1]], axis=-1)  # fmt: skip
    scale = np.where(angle < 1e-6, 0.5, angle / (2 * np.maximum(np.sin(angle), 1e-12)))
    return skew * scale[:, None]
