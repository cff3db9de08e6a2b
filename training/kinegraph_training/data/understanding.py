"""The one place where recordings of any format become joints of kinegraph, and what was understood of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray, Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINT_NAMES, PELVIS, canonicalise
from kinegraph_training.data.body import (
    UNITS,
    check_bones,
    facing_axis,
    find_up,
    guess_unit,
    rotation_to_y_up,
    sides_exchanged,
)
from kinegraph_training.data.folder import STEP_METRES
from kinegraph_training.data.jumps import find_jumps, motion_start
from kinegraph_training.data.recording import Recording, check_size, resampled_times
from kinegraph_training.data.retargeting import (
    JointMap,
    Source,
    find_joint_map,
    map_joints,
    without_zero_length,
)


@dataclass(frozen=True)
class Stated:
    """What a user states of the files; None is found from the body."""

    scale: float | None = None
    """Metres per unit."""
    up: str | None = None
    """Axis that points up, of `body.UP_AXES`."""
    handedness: str | None = None
    """"right" or "left": of the axes."""
    joint_sources: Mapping[str, Source] = field(default_factory=dict)
    """Entries of a map file, which come before the built-in naming conventions."""


@dataclass(frozen=True)
class Understood:
    """Motion of one recording as kinegraph holds it, and what was found out about its file."""

    joints: FloatArray
    """(frames, 22, 3) metres, Y up, starting on the origin and facing +Z."""
    frames: int
    """Of the file."""
    fps: float
    """Of the file."""
    up: str
    facing: str
    """Axis of the file that the body faces in its first frame."""
    scale: float
    """Metres per unit."""
    names: str
    """Naming convention of the joints."""
    warnings: tuple[str, ...]
    start: float = 0.0
    """Seconds cut at the start of the file: a pose before the motion."""

    @property
    def unit(self) -> str:
        """Name of the unit, or metres per unit."""
        return next((name.split()[0] for name, unit in UNITS.items() if unit == self.scale), f"{self.scale:.4g} m")


def understand(recording: Recording, stated: Stated, fps: float) -> Understood:
    """Bring a recording to the 22 joints, metres and `fps`, Y up, starting on the origin and facing +Z.

    Raises:
        InvalidInputError: joints that cannot be mapped, bones without length, no sensible size or side; the message
            names the option that cures it. `UnclearUpError` where the body does not tell what is up.
    """
    warnings = list(recording.warnings)
    joint_map, positions = _mapped(recording, stated, warnings)
    up, warning = _up(recording, joint_map, positions, stated.up)
    turn = rotation_to_y_up(up)
    mirrored = stated.handedness == "left"
    if mirrored:
        turn = np.diag([-1.0, 1.0, 1.0]) @ turn
    upright = positions @ turn.T
    exchanged, doubt = sides_exchanged(upright)
    if exchanged:
        raise InvalidInputError(_exchanged(exchanged, stated.handedness))
    scale = guess_unit(upright) if stated.scale is None else stated.scale
    start = motion_start(upright * scale, recording.fps)
    if start:
        warnings.append(f"{start} frame{'s' * (start > 1)} before a jump at the start cut: a pose, no motion")
    jumps = find_jumps(upright[start:] * scale, recording.fps) + start
    if len(jumps):
        at = ", ".join(f"{frame / recording.fps:.2f}" for frame in jumps[:3])
        warnings.append(f"joints jump at {at} s{' and later' if len(jumps) > 3 else ''}")
    times = resampled_times(recording.frames, recording.fps, fps, start)
    check_size(len(times), len(recording.names), f"at {fps:g} frames per second (--fps) it has")
    if len(times) < 2:
        raise InvalidInputError(f"less than two frames at {fps:g} frames per second; too short to train on")
    resampled = map_joints(recording.sample(times), recording.names, joint_map)
    joints = canonicalise(resampled @ turn.T * scale)
    _check_range(joints)
    return Understood(
        joints=joints,
        frames=recording.frames,
        fps=recording.fps,
        up=up,
        facing=facing_axis(upright[start:], up, mirrored),
        scale=scale,
        names=joint_map.convention,
        warnings=(*warnings, *filter(None, (warning, doubt))),
        start=start / recording.fps,
    )


def _mapped(recording: Recording, stated: Stated, warnings: list[str]) -> tuple[JointMap, Floats]:
    """Map the joints of all frames to (frames, 22, 3), in the units and axes of the file; adds to `warnings`."""
    joint_map = find_joint_map(recording.names, stated.joint_sources)
    places = recording.sample(np.arange(recording.frames, dtype=np.float64))
    if not np.isfinite(places).all():
        raise InvalidInputError("joints are not at finite places; export the file again")
    joint_map, dropped = without_zero_length(joint_map, places, recording.names)
    between = [joint for joint in JOINT_NAMES if joint not in joint_map.sources]
    if between:
        why = f" ({', '.join(dropped)} lay on a neighbour)" if dropped else ""
        warnings.append(f"put between their neighbours: {', '.join(between)}{why}")
    positions = map_joints(places, recording.names, joint_map)
    taken_from = {joint: source if isinstance(source, str) else "a point of --map"
                  for joint, source in joint_map.sources.items()}  # fmt: skip
    check_bones(positions, recording.fps, taken_from)
    return joint_map, positions


def _up(recording: Recording, joint_map: JointMap, positions: Floats, stated: str | None) -> tuple[str, str | None]:
    """Return the axis that points up, and a warning: what the user states, the format fixes, or the body tells."""
    if recording.up is not None:
        return recording.up, None
    rest = None
    if recording.rest is not None:
        rest = map_joints(recording.rest[None], recording.names, joint_map)[0]
    if stated is None:
        return find_up(positions, rest)
    try:
        found, _ = find_up(positions, rest)
    except InvalidInputError:
        found = stated
    return stated, None if found == stated else f"--up={stated} was given, but the body stands along {found}"


def _exchanged(exchanged: str, handedness: str | None) -> str:
    """Word the error for left and right exchanged."""
    if handedness == "left":
        return f"with --handedness left, {exchanged}: left and right are exchanged; leave the option out for this file"
    return (
        f"{exchanged}: left and right are exchanged, as in files with left-handed axes; pass --handedness left, which "
        "negates an axis"
    )


_MOST: Final = np.iinfo(np.int16).max * STEP_METRES
"""Metres from the pelvis on the floor plane, or above the floor, that a data folder can store."""


def _check_range(joints: FloatArray) -> None:
    """Refuse joints that 16-bit multiples of `STEP_METRES` cannot hold."""
    relative = joints.copy()
    relative[..., [0, 2]] -= joints[:, PELVIS : PELVIS + 1, [0, 2]]
    if not np.isfinite(joints).all() or np.abs(relative).max() > _MOST:
        raise InvalidInputError("a joint is more than 3.2 m from the body or above the floor; check --scale and --up")
