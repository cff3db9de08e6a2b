"""Reader of `.bvh` files that `formats.bvh` wrote: its joints, in its order, in centimetres.

Strict on purpose. Files of other programs have other skeletons, units and axes; training reads those
(`kinegraph_training.data.bvh`). Angles and centimetres have six decimals, so joints come back to 0.01 mm.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.formats.bvh import CENTIMETRES, depth_first, hierarchy_lines
from kinegraph.limits import MAX_READ_FRAMES
from kinegraph.motion.kinematics import RootMotion, forward_kinematics, join_root
from kinegraph.motion.quaternions import IDENTITY, about_axis, multiply
from kinegraph.motion.skeleton import CONVENTIONS, JOINTS, PELVIS, ROOT_NAME
from kinegraph.validation import check_fps

_MAX_LINES: Final = 200
"""Lines of the HIERARCHY section; ours has 114 at most."""
_MAX_LINE: Final = 4096
"""Characters of a line; a frame of ours has 75 numbers."""


def decode(data: bytes) -> dict[str, Any]:
    """Decode a file into joints and frame rate.

    Raises:
        InvalidInputError: not a BVH file that `formats.bvh.encode` could have written.
    """
    if not data.endswith(b"\n"):
        raise InvalidInputError("it is cut short: it ends within a line")
    lines = _words(data)
    offsets, root = _read_hierarchy(lines)
    frames, fps = _read_header(lines)
    width = 6 + 3 * (JOINTS - 1) + (6 if root else 0)
    # every number takes two bytes at least: no array is larger than the file allows
    if not 1 <= frames <= MAX_READ_FRAMES or frames * width * 2 > len(data):
        raise InvalidInputError(f"its {str(frames)[:20]} frames are not 1 to {MAX_READ_FRAMES}, or not all there")
    rows: Floats = np.empty((frames, width))
    for frame in range(frames):
        words = next(lines, [])
        if len(words) != width:
            raise InvalidInputError(f"frame {frame + 1} of {frames} has {len(words)} numbers, not {width}")
        try:
            rows[frame] = words
        except ValueError as error:
            raise InvalidInputError(f"frame {frame + 1}: {str(error)[:200]}") from error
    if any(lines):
        raise InvalidInputError(f"it has more than the {frames} frames that it announces")
    if not np.isfinite(rows).all():
        raise InvalidInputError("it holds numbers that are not finite")
    return {"joints": _joints(offsets, rows, root), "fps": fps}


def _words(data: bytes) -> Iterator[list[str]]:
    """Split the file into words, line by line; lines without any are left out.

    Raises:
        InvalidInputError: not ASCII, or a line is too long.
    """
    stream = io.BytesIO(data)
    while line := stream.readline(_MAX_LINE):
        try:
            words = line.decode("ascii").split()
        except UnicodeDecodeError as error:
            raise InvalidInputError("it is no text in ASCII") from error
        if len(line) == _MAX_LINE:
            raise InvalidInputError(f"a line is longer than {_MAX_LINE} characters")
        if words:
            yield words


def _read_hierarchy(lines: Iterator[list[str]]) -> tuple[Floats, bool]:
    """Read up to MOTION: offsets (22, 3) metres, and whether there is a root joint.

    Raises:
        InvalidInputError: another skeleton than ours in one of its conventions.
    """
    read: list[list[str]] = []
    for words in lines:
        read.append(words)
        if words == ["MOTION"] or len(read) > _MAX_LINES:
            break
    skeleton = [words for words in read if words[0] != "OFFSET"]
    for names in CONVENTIONS:
        for root in (False, True):
            expected = [line.split() for line in hierarchy_lines(np.zeros((JOINTS, 3)), names, root)]
            if skeleton == [words for words in expected if words[0] != "OFFSET"] and len(read) == len(expected):
                return _read_offsets(read, names, root), root
    starts = ", ".join(f"ROOT {names[PELVIS]}" for names in CONVENTIONS.values())
    raise InvalidInputError(
        f"its joints or channels are not those of kinegraph, which start with {starts} or ROOT {ROOT_NAME}"
    )


def _read_offsets(lines: list[list[str]], names: str, root: bool) -> Floats:
    """Read the OFFSETs of the joints: (22, 3) metres; root and End Sites are left out.

    Raises:
        InvalidInputError: an OFFSET is not three finite numbers.
    """
    offsets = np.zeros((JOINTS, 3))
    index = {name: joint for joint, name in enumerate(CONVENTIONS[names])}
    joint = None
    for words in lines:
        if words[0] in ("ROOT", "JOINT", "End"):
            joint = index.get(words[1])
        elif words[0] == "OFFSET" and joint is not None:
            try:
                x, y, z = map(float, words[1:])
            except ValueError as error:
                raise InvalidInputError(f"an OFFSET is {' '.join(words[1:])[:60]!r}, not three numbers") from error
            offsets[joint] = x, y, z
    if not np.isfinite(offsets).all():
        raise InvalidInputError("an OFFSET is not finite")
    return offsets / CENTIMETRES


def _read_header(lines: Iterator[list[str]]) -> tuple[int, float]:
    """Read the number of frames and the frame rate.

    Raises:
        InvalidInputError: other words or numbers.
    """
    first, second = next(lines, []), next(lines, [])
    try:
        if first[:-1] != ["Frames:"] or second[:-1] != ["Frame", "Time:"]:
            raise ValueError("other words")
        frames, frame_time = int(first[-1]), float(second[-1])
        fps = 1.0 / frame_time
    except (IndexError, ValueError, ZeroDivisionError) as error:
        raise InvalidInputError(
            'its MOTION section does not start with "Frames: N" and "Frame Time: SECONDS"'
        ) from error
    # the time is rounded: take the frame rate with the fewest decimals that is written the same
    rounded = (round(fps, digits) for digits in range(7))
    same = (rate for rate in rounded if rate and f"{1.0 / rate:.8f}" == f"{frame_time:.8f}")
    fps = next(same, fps)
    check_fps(fps)
    return frames, fps


def _joints(offsets: Floats, rows: Floats, root: bool) -> Floats:
    """Compute joints (frames, 22, 3) metres from offsets and channel values."""
    root_positions: Floats = np.zeros((len(rows), 3))
    root_rotations: Floats = np.tile(np.array(IDENTITY), (len(rows), 1))
    if root:
        root_positions, root_rotations = rows[:, :3] / CENTIMETRES, _rotations(rows[:, 3:6])[:, 0]
        rows = rows[:, 6:]
    rotations = np.empty((len(rows), JOINTS, 4))
    rotations[:, depth_first(PELVIS)] = _rotations(rows[:, 3:])
    split = RootMotion(root_positions, root_rotations, rows[:, :3] / CENTIMETRES, rotations[:, PELVIS])
    pelvis, rotations[:, PELVIS] = join_root(split)
    return forward_kinematics(offsets, pelvis, rotations)


def _rotations(degrees: Floats) -> Floats:
    """Convert channel values (frames, 3 n) in the order Z, X, Y to quaternions (frames, n, 4)."""
    z, x, y = np.moveaxis(np.radians(degrees).reshape(len(degrees), -1, 3), -1, 0)
    return multiply(multiply(about_axis(2, z), about_axis(0, x)), about_axis(1, y))
