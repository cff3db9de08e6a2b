"""BVH files of synthetic motion, and the joints they must give, computed with matrices."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinegraph.motion.skeleton import PARENTS
from kinegraph_training.prepare import PrepareOptions, clip_joints

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
    """Write a file of smooth synthetic motion and compute its joints (frames, 22, 3) in centimetres."""
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
        # position channels replace OFFSET, so a wrong one must not matter
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

    rows, positions = [], np.zeros((frames, 22, 3))
    for frame in range(frames):
        numbers: list[float] = []
        for joint in depth_first(0):
            numbers += list(root[frame] if joint == 0 else OFFSETS[joint]) if with_position[joint] else []
            numbers += list(degrees[frame, joint])
        rows.append(" ".join(f"{number:.9f}" for number in numbers))
        axes: list[np.ndarray] = []
        for joint, parent in enumerate(PARENTS):
            local = np.eye(3)
            for axis, angle in zip(order_of[joint], degrees[frame, joint], strict=True):
                local = local @ turn(axis, np.radians(angle))
            if parent < 0:
                axes.append(local)
                positions[frame, joint] = root[frame]
            else:
                axes.append(axes[parent] @ local)
                positions[frame, joint] = positions[frame, parent] + axes[parent] @ OFFSETS[joint]
    motion = ["MOTION", f"Frames: {frames}", f"Frame Time: {1 / fps:.8f}", *rows]
    return "\n".join(["HIERARCHY", *lines(0), *motion]) + "\n", positions


def write_bvh_folder(tmp_path: Path, files: dict[str, str], captions: dict[str, str] | None = None) -> list[str]:
    """Write a folder of BVH files with captions and return the arguments that prepare them."""
    for name, text in files.items():
        path = tmp_path / "bvh" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    captions = captions if captions is not None else dict.fromkeys(files, "a person moves")
    (tmp_path / "c.csv").write_text("file,caption\n" + "".join(f"{k},{v}\n" for k, v in captions.items()))
    return [
        "--bvh",
        str(tmp_path / "bvh"),
        "--captions",
        str(tmp_path / "c.csv"),
        "--out",
        str(tmp_path / "out"),
    ]


def prepare_joints(tmp_path: Path, text: str, **options: object) -> np.ndarray:
    """Prepare one BVH file: its joints (frames, 22, 3) in metres."""
    path = tmp_path / "one.bvh"
    path.write_text(text)
    return clip_joints(path, PrepareOptions(**options))  # type: ignore[arg-type]
