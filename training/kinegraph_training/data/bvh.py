"""BVH files: parsing, resampling, and forward kinematics.

Parsing is strict. A file that is cut short, or whose header disagrees with its data, is refused: a model trained on it
would not show the fault.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.quaternions import IDENTITY, about_axis, multiply, rotate, slerp

AXES: Final = {"X": 0, "Y": 1, "Z": 2}
END: Final = ".end"
"""Suffix of the name of an End Site: `Head.end` is that of `Head`."""


@dataclass(frozen=True)
class Bone:
    """Joint of the hierarchy, with the bone from its parent."""

    name: str
    parent: int
    """-1 for a root."""
    offset: tuple[float, float, float]
    """From the parent, in the units of the file."""
    channels: tuple[str, ...] = ()
    """For example ("Xposition", "Zrotation"); none for an End Site."""


@dataclass(frozen=True)
class BvhMotion:
    """Motion of a file, in its own units and axes."""

    bones: tuple[Bone, ...]
    """Parents before children."""
    positions: Floats
    """(frames, bones, 3) from the parent: OFFSET, or the position channels where a joint has them."""
    rotations: Floats
    """(frames, bones, 4) quaternions relative to the parent."""
    frame_time: float
    """Seconds."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all joints, End Sites included."""
        return tuple(bone.name for bone in self.bones)


@dataclass
class _OpenJoint:
    """Joint whose closing brace has not been read."""

    name: str
    parent: int
    offset: tuple[float, float, float] | None = None
    channels: tuple[str, ...] = ()
    index: int = field(default=-1)


def read_bvh(path: Path) -> BvhMotion:
    """Read a BVH file.

    Raises:
        InvalidInputError: missing, or not a BVH file; the message names file and fault.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read ({error.strerror}); check the name") from error
    # Names may be in any encoding; the rest is ASCII.
    text = data.decode("utf-8-sig", errors="replace")
    try:
        return parse_bvh(text)
    except InvalidInputError as error:
        raise InvalidInputError(f"{path}: {error}") from error


def parse_bvh(text: str) -> BvhMotion:
    """Parse the text of a BVH file; see `read_bvh`."""
    # MOTION stands on a line of its own; joints may be called "motion" too.
    head, *rest = re.split(r"^[ \t]*MOTION[ \t]*\r?$", text, maxsplit=1, flags=re.MULTILINE)
    if not head.lstrip().upper().startswith("HIERARCHY") or not rest:
        raise InvalidInputError("no BVH file: it must start with HIERARCHY and have a MOTION part")
    bones = _parse_hierarchy(head.lstrip())
    frames, frame_time, values = _parse_motion(rest[0])
    width = sum(len(bone.channels) for bone in bones)
    if len(values) != frames * width:
        raise InvalidInputError(
            f"{frames} frames of {width} channels are {frames * width} numbers, but the MOTION part holds "
            f"{len(values)}; the file is cut short or mixed up"
        )
    if not np.isfinite(values).all():
        raise InvalidInputError("the MOTION part holds numbers that are not finite; export it again")
    positions, rotations = _local_motion(bones, values.reshape(frames, width))
    return BvhMotion(tuple(bones), positions, rotations, frame_time)


def resample_bvh(motion: BvhMotion, fps: float) -> BvhMotion:
    """Resample to another frame rate, rotations by slerp (Shoemake, 1985), positions linearly.

    The motion keeps its duration, or loses less than one frame.
    """
    last = float(len(motion.positions) - 1)
    count = int(last * motion.frame_time * fps + 1e-4) + 1
    position: Floats = np.minimum(np.arange(count) / (fps * motion.frame_time), last)
    # Frame times are rounded in the file (0.0333333): a position that close to a frame is that frame.
    position = np.where(np.abs(position - np.round(position)) < 1e-3, np.round(position), position)
    before = np.floor(position).astype(np.int64)
    after = np.minimum(before + 1, len(motion.positions) - 1)
    fraction = position - before
    positions = motion.positions[before]
    positions = positions + fraction[:, None, None] * (motion.positions[after] - positions)
    fractions = np.broadcast_to(fraction[:, None], (count, len(motion.bones)))
    rotations = slerp(motion.rotations[before], motion.rotations[after], fractions)
    return replace(motion, positions=positions, rotations=rotations, frame_time=1.0 / fps)


def joint_positions(motion: BvhMotion) -> Floats:
    """Compute the global position of every joint by forward kinematics.

    Returns:
        (frames, bones, 3) in the units and axes of the file.
    """
    positions = np.array(motion.positions)
    rotations = np.array(motion.rotations)
    for index, bone in enumerate(motion.bones):
        if bone.parent >= 0:
            parent = rotations[:, bone.parent]
            positions[:, index] = positions[:, bone.parent] + rotate(parent, motion.positions[:, index])
            rotations[:, index] = multiply(parent, motion.rotations[:, index])
    return positions


def _parse_hierarchy(head: str) -> list[Bone]:
    """Parse the HIERARCHY part; returns joints in the order of the file, parents before children."""
    lines = head.replace("{", "\n{\n").replace("}", "\n}\n").splitlines()[1:]
    done: dict[int, Bone] = {}
    stack: list[_OpenJoint] = []
    count = 0
    for line in lines:
        words = line.split()
        if not words or words == ["{"]:
            continue
        key = words[0].upper()
        if key in ("ROOT", "JOINT", "END"):
            parent = stack[-1] if stack else None
            name = parent.name + END if key == "END" and parent else " ".join(words[1:])
            stack.append(_OpenJoint(name, parent.index if parent else -1, index=count))
            count += 1
        elif not stack:
            raise InvalidInputError(f"{line.strip()!r} stands outside of every joint in the HIERARCHY part")
        elif key == "OFFSET":
            stack[-1].offset = _parse_offset(stack[-1].name, words[1:])
        elif key == "CHANNELS":
            stack[-1].channels = _parse_channels(stack[-1].name, words[1:])
        elif key == "}":
            joint = stack.pop()
            if joint.offset is None:
                raise InvalidInputError(f"joint {joint.name!r} has no OFFSET")
            done[joint.index] = Bone(joint.name, joint.parent, joint.offset, joint.channels)
        else:
            raise InvalidInputError(f"{line.strip()!r} is no line of a HIERARCHY part")
    if stack or not done:
        raise InvalidInputError("the HIERARCHY part has no joint or ends inside of one; the file is cut short")
    return [done[index] for index in range(count)]


def _parse_offset(name: str, words: list[str]) -> tuple[float, float, float]:
    try:
        x, y, z = (float(word) for word in words)
    except ValueError as error:
        raise InvalidInputError(f"OFFSET of {name!r} is {' '.join(words)!r}; it must be three numbers") from error
    if not np.isfinite([x, y, z]).all():
        raise InvalidInputError(f"OFFSET of {name!r} is not finite")
    return x, y, z


def _parse_channels(name: str, words: list[str]) -> tuple[str, ...]:
    channels = tuple(word[:1].upper() + word[1:].lower() for word in words[1:])
    known = all(word[0] in AXES and word[1:] in ("position", "rotation") for word in channels)
    if not words or words[0] != str(len(channels)) or not known or len(set(channels)) < len(channels):
        raise InvalidInputError(
            f"CHANNELS of {name!r} is {' '.join(words)!r}; it must be their number and different ones of "
            "X, Y, Zposition and X, Y, Zrotation"
        )
    return channels


def _parse_motion(text: str) -> tuple[int, float, Floats]:
    """Parse the MOTION part; returns number of frames, frame time in seconds, and all values in one row."""
    words = text.split()
    try:
        if words[0].rstrip(":") != "Frames" or [words[2], words[3].rstrip(":")] != ["Frame", "Time"]:
            raise ValueError("other words")
        frames, frame_time = int(words[1]), float(words[4])
    except (IndexError, ValueError) as error:
        raise InvalidInputError('the MOTION part must start with "Frames: N" and "Frame Time: SECONDS"') from error
    if frames < 1 or not (np.isfinite(frame_time) and frame_time > 0):
        raise InvalidInputError(f"{frames} frames of {frame_time} seconds; both must be above 0")
    try:
        return frames, frame_time, np.array(words[5:], dtype=np.float64)
    except ValueError as error:
        raise InvalidInputError(f"the MOTION part must hold numbers only ({error})") from error


def _local_motion(bones: list[Bone], values: Floats) -> tuple[Floats, Floats]:
    """Compute positions and rotations relative to the parents from channel values (frames, channels)."""
    positions = np.tile(np.array([bone.offset for bone in bones]), (len(values), 1, 1))
    rotations = np.tile(np.array(IDENTITY), (len(values), len(bones), 1))
    column = 0
    for index, bone in enumerate(bones):
        for channel in bone.channels:
            axis, column_values = AXES[channel[0]], values[:, column]
            column += 1
            if channel.endswith("position"):
                # Position channels replace the OFFSET, as in Bandai Namco's files and for roots of motion capture.
                positions[:, index, axis] = column_values
            else:
                # The channel named first is the outermost rotation.
                rotations[:, index] = multiply(rotations[:, index], about_axis(axis, np.radians(column_values)))
    return positions, rotations
