"""BVH files: parsing, resampling, and forward kinematics.

A file that is cut short, or whose header disagrees with its data, is refused: a model trained on it would not show the
fault. What exporters are known to write otherwise than the format says is read, and told as a warning.
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
from kinegraph.validation import short_repr
from kinegraph_training.data.naming import END
from kinegraph_training.data.recording import (
    MAX_FPS,
    MIN_FPS,
    Recording,
    check_size,
    nominal_fps,
    read_bytes,
    resampled_times,
)

AXES: Final = {"X": 0, "Y": 1, "Z": 2}
_HEADER: Final = re.compile(r"\s*Frames\s*:?\s*(\S+)\s+Frame\s*Time\s*:?\s*(\S+)", re.IGNORECASE)
_SPACE: Final = re.compile(r"\s|\Z")
_BLOCK: Final = 1 << 20
"""Characters of the MOTION part that are parsed at once; the words of all of it would take eight times its size."""


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
    warnings: tuple[str, ...] = ()
    """What the file has otherwise than the format says, and how it was read."""

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
        InvalidInputError: missing, too large, or not a BVH file; the message does not name the file.
    """
    data = read_bytes(path)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InvalidInputError("it is UTF-16; save it as UTF-8 or ASCII")
    # Names may be in any encoding; the rest is ASCII.
    return parse_bvh(data.decode("utf-8-sig", errors="replace"))


def parse_bvh(text: str) -> BvhMotion:
    """Parse the text of a BVH file; see `read_bvh`."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    # MOTION stands on a line of its own; joints may be called "motion" too.
    head, *rest = re.split(r"^[ \t]*MOTION[ \t]*$", text, maxsplit=1, flags=re.MULTILINE)
    if not head.lstrip().upper().startswith("HIERARCHY") or not rest:
        raise InvalidInputError("no BVH file: it must start with HIERARCHY and have a MOTION part")
    warnings = []
    motion = rest[0]
    if re.search(r"\d,\d", motion) and not re.search(r"\d\.\d", motion):
        warnings.append("commas in numbers are read as decimal points")
        motion = motion.replace(",", ".")
        head = re.sub(
            r"^\s*OFFSET.*$", lambda line: line[0].replace(",", "."), head, flags=re.MULTILINE | re.IGNORECASE
        )
    bones = _parse_hierarchy(head.lstrip())
    frames, frame_time, start = _parse_header(motion)
    width = sum(len(bone.channels) for bone in bones)
    check_size(frames, len(bones), "the file has")
    values = _parse_values(motion, start, most=(frames + 2) * width)
    if width and len(values) == (frames + 1) * width:
        warnings.append(f"it says {frames} frames and holds {frames + 1}, which are all taken")
        frames += 1
    if len(values) != frames * width:
        raise InvalidInputError(
            f"{frames} frames of {width} channels are {frames * width} numbers, but the MOTION part holds "
            f"{'more' if len(values) > (frames + 1) * width else len(values)}; the file is cut short or mixed up"
        )
    if not np.isfinite(values).all():
        raise InvalidInputError("the MOTION part holds numbers that are not finite; export it again")
    positions, rotations, unused = _local_motion(bones, values.reshape(frames, width))
    if unused:
        warnings.append(f"position channels of {unused} joints are all zero: their OFFSET is used")
    return BvhMotion(tuple(bones), positions, rotations, frame_time, tuple(warnings))


def resample_bvh(motion: BvhMotion, fps: float) -> BvhMotion:
    """Resample to another frame rate, rotations by slerp (Shoemake, 1985), positions linearly.

    The motion keeps its duration, or loses less than one frame.
    """
    times = resampled_times(len(motion.positions), 1.0 / motion.frame_time, fps)
    return replace(sample_bvh(motion, times), frame_time=1.0 / fps)


def sample_bvh(motion: BvhMotion, times: Floats) -> BvhMotion:
    """Interpolate the motion at `times`, in frames of the file."""
    before = np.floor(times).astype(np.int64)
    after = np.minimum(before + 1, len(motion.positions) - 1)
    fraction = times - before
    positions = motion.positions[before]
    positions = positions + fraction[:, None, None] * (motion.positions[after] - positions)
    fractions = np.broadcast_to(fraction[:, None], (len(times), len(motion.bones)))
    rotations = slerp(motion.rotations[before], motion.rotations[after], fractions)
    return replace(motion, positions=positions, rotations=rotations)


def read_recording(path: Path) -> Recording:
    """Read a BVH file as a recording.

    Raises:
        InvalidInputError: see `read_bvh`.
    """
    return recording_of(read_bvh(path))


def recording_of(motion: BvhMotion) -> Recording:
    """Make a recording of the motion of a file; its rest pose is that of the OFFSETs."""
    rest = replace(
        motion,
        positions=np.array([[bone.offset for bone in motion.bones]]),
        rotations=np.tile(np.array(IDENTITY), (1, len(motion.bones), 1)),
    )
    return Recording(
        names=motion.names,
        frames=len(motion.positions),
        fps=nominal_fps(1.0 / motion.frame_time),
        sample=lambda times: joint_positions(sample_bvh(motion, times)),
        rest=joint_positions(rest)[0],
        warnings=motion.warnings,
    )


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
            check_size(1, count, "the file has at least")
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


def _parse_header(text: str) -> tuple[int, float, int]:
    """Parse the start of the MOTION part; returns number of frames, frame time in seconds, and where it ends.

    Raises:
        InvalidInputError: other words, no frames, or a frame rate outside `MIN_FPS` to `MAX_FPS`.
    """
    header = _HEADER.match(text)
    try:
        if header is None:
            raise ValueError("other words")
        frames, frame_time = int(header[1]), float(header[2])
    except ValueError as error:
        raise InvalidInputError('the MOTION part must start with "Frames: N" and "Frame Time: SECONDS"') from error
    if frames < 1 or not (np.isfinite(frame_time) and frame_time > 0):
        raise InvalidInputError(f"{short_repr(frames)} frames of {frame_time} seconds; both must be above 0")
    if not MIN_FPS <= 1.0 / frame_time <= MAX_FPS:
        raise InvalidInputError(
            f"Frame Time is {frame_time:g} seconds, which is {1.0 / frame_time:.4g} frames per second, not {MIN_FPS:g} "
            f"to {MAX_FPS:g}; write the seconds of one frame there, for example 0.033333"
        )
    return frames, frame_time, header.end()


def _parse_values(text: str, start: int, most: int) -> Floats:
    """Parse the numbers from `start` on, in one row; stops above `most`.

    Raises:
        InvalidInputError: other words.
    """
    blocks: list[Floats] = []
    while start < len(text) and sum(map(len, blocks)) <= most:
        space = _SPACE.search(text, min(start + _BLOCK, len(text)))
        stop = space.end() if space else len(text)
        try:
            blocks.append(np.array(text[start:stop].split(), dtype=np.float64))
        except ValueError as error:
            raise InvalidInputError(f"the MOTION part must hold numbers only ({str(error)[:200]})") from error
        start = stop
    return np.concatenate([np.zeros(0), *blocks])


def _local_motion(bones: list[Bone], values: Floats) -> tuple[Floats, Floats, int]:
    """Compute positions and rotations relative to the parents from channel values (frames, channels).

    Position channels replace the OFFSET, as in Bandai Namco's files and for roots of motion capture. Below the root,
    channels that are zero throughout would put a joint onto its parent: the OFFSET stays. The joints for which it did
    are counted.
    """
    positions = np.tile(np.array([bone.offset for bone in bones]), (len(values), 1, 1))
    rotations = np.tile(np.array(IDENTITY), (len(values), len(bones), 1))
    column, unused = 0, 0
    for index, bone in enumerate(bones):
        columns = range(column, column + len(bone.channels))
        column = columns.stop
        moving = [at for at, channel in zip(columns, bone.channels, strict=True) if channel.endswith("position")]
        ignored = bool(moving) and bone.parent >= 0 and any(bone.offset) and not values[:, moving].any()
        unused += ignored
        for at, channel in zip(columns, bone.channels, strict=True):
            axis = AXES[channel[0]]
            if at not in moving:
                # The channel named first is the outermost rotation.
                rotations[:, index] = multiply(rotations[:, index], about_axis(axis, np.radians(values[:, at])))
            elif not ignored:
                positions[:, index, axis] = values[:, at]
    return positions, rotations, unused
