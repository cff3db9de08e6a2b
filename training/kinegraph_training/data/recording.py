"""Recordings: what a reader of motion files hands on, whatever the format.

A reader knows the format only. Names, units, axes and captions are understood in one place for all of them
(`understanding`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError

MIN_FPS: Final = 5.0
MAX_FPS: Final = 1000.0
"""Frames per second of a file."""

MAX_POINTS: Final = 5_000_000
"""Frames times joints of a recording: ten minutes of 80 joints at 100 per second, some 1 GB at the peak."""

MAX_BYTES: Final = 256 << 20
"""Size of a file."""


MAX_JOINTS: Final = 2000
"""Of a recording, End Sites included; hands and a face make 200."""


@dataclass(frozen=True)
class Recording:
    """Motion of named joints, in the units and axes of its file."""

    names: tuple[str, ...]
    """Of the n joints, End Sites as `Foot.end`."""
    frames: int
    fps: float
    sample: Callable[[Floats], Floats]
    """Times in frames (k,) -> positions (k, n, 3)."""
    rest: Floats | None = None
    """(n, 3) rest pose, if the format has one."""
    up: str | None = None
    """Axis that points up, where the format fixes it; None finds it from the body."""
    warnings: tuple[str, ...] = ()
    """What was not as the format says, and how it was read."""


@dataclass(frozen=True)
class Take:
    """Recording that can be read, with its captions: one entry of a data set."""

    id: str
    """Path below the folder, without suffix, with `/`."""
    source_file: str
    captions: tuple[str, ...]
    read: Callable[[], Recording]
    """Read it; raises `KinegraphError`."""


def read_bytes(path: Path) -> bytes:
    """Read a file of at most `MAX_BYTES`.

    Raises:
        InvalidInputError: missing, unreadable or larger; the message does not name the file.
    """
    if path.exists() and not path.is_file():
        raise InvalidInputError("it is a folder, a pipe or a device, and no file")
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InvalidInputError(f"it cannot be read ({error.strerror}); check the name") from error
    if len(data) > MAX_BYTES:
        raise InvalidInputError(f"it has more than {MAX_BYTES >> 20} MB; cut it into takes")
    return data


def check_size(frames: int, joints: int, what: str) -> None:
    """Refuse more than `MAX_JOINTS` and `MAX_POINTS`, before anything is allocated for them.

    Raises:
        InvalidInputError: the message starts with `what`.
    """
    if joints > MAX_JOINTS:
        raise InvalidInputError(f"{what} {joints:,} joints; {MAX_JOINTS:,} are read: export the skeleton of the body")
    if frames * joints > MAX_POINTS:
        counts = f"{min(frames, 10**12):,} frames of {joints:,} joints"
        raise InvalidInputError(f"{what} {counts}; {MAX_POINTS:,} of frames x joints are read: cut it into takes")


def resampled_times(frames: int, fps: float, new_fps: float, first: int = 0) -> Floats:
    """Return the times of new frames, in frames of the old rate, from frame `first` on.

    The motion keeps its duration, or loses less than one frame.
    """
    last = float(frames - 1 - first)
    times: Floats = np.minimum(np.arange(int(last / fps * new_fps + 1e-4) + 1) * (fps / new_fps), last)
    # Frame times are rounded in the file (0.0333333): a time that close to a frame is that frame.
    return first + np.where(np.abs(times - np.round(times)) < 1e-3, np.round(times), times)


def nominal_fps(fps: float) -> float:
    """Return the whole frame rate that a rounded frame time stands for: 30 for 30.0003."""
    return float(round(fps)) if abs(fps / round(fps) - 1) < 2e-4 else fps
