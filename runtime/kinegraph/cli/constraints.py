"""Constraints on the command line: flags and files as constraints, and how far a clip missed them.

--path "0,0 1,2@3s 3,2"      points x,z in metres, each with a time or none
--waypoint 2.5s=1,2          x,z, and the heading in degrees as a third number
--hand right@2s=.3,1.5,.4    x,y,z; _ is free; 2-3s is a while. --foot left@..., --joint head@...
--keyframe 2s=bow.npz@1.5s   the pose of a saved clip at 1.5 s
--start, --end CLIP          the end of a saved clip first, the beginning of one last
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, Final

from kinegraph.errors import InvalidInputError

if TYPE_CHECKING:
    from kinegraph.constraints import Constraint, Miss, Waypoint

_FREE: Final = "_"
_SECONDS: Final = re.compile(r"\s*([0-9.eE+]+?)(?:-([0-9.eE+]+?))?\s*s?\s*")
"""A moment "2.5s" or a while "2-3s"; the unit may be left out."""


def add_constraints(parser: argparse.ArgumentParser) -> None:
    """Add the flags of constraints."""
    group = parser.add_argument_group("where and when", "metres, +Y up; clips start at 0,0 and face +Z, left is +X")
    for flag, metavar, description in (
        (
            "--path",
            "'X,Z X,Z ...'",
            "points that the person walks along, e.g. '0,0 1,2 3,2'; with times: '0,0@0s 1,2@3s'",
        ),
        (
            "--waypoint",
            "TIME=X,Z",
            "where the person is at a time, e.g. 2.5s=1,2; a third number is the heading, degrees",
        ),
        ("--hand", "SIDE@TIME=X,Y,Z", "where a hand is, e.g. right@2s=.3,1.5,.4; _ for what is free, 2-3s for a while"),
        ("--foot", "SIDE@TIME=X,Y,Z", "the same for a foot"),
        ("--joint", "NAME@TIME=X,Y,Z", "the same for any joint, e.g. head@2s=_,1.2,_"),
        ("--keyframe", "TIME=CLIP@TIME", "a pose of a saved clip, e.g. 2s=bow.npz@1.5s"),
    ):
        group.add_argument(flag, action="append", default=[], metavar=metavar, help=description)
    group.add_argument("--start", type=FilePath, metavar="CLIP", help="begin as this saved clip ended")
    group.add_argument("--end", type=FilePath, metavar="CLIP", help="end as this saved clip begins")
    group.add_argument("--loop-pose", action="store_true", help="end in the pose of the beginning, for --loop")
    group.add_argument(
        "--constraints", type=FilePath, metavar="FILE.json", help="constraints of a file, ours or kimodo's"
    )
    group.add_argument(
        "--constraint-weight", type=float, default=1.0, metavar="X", help="of all together against the text; default 1"
    )


def parse_constraints(args: argparse.Namespace) -> list[Constraint]:
    """Make the constraints of a command's flags and files.

    Raises:
        InvalidInputError: a flag or a file is not valid; the message shows it.
    """
    flags = (args.path, args.waypoint, args.hand, args.foot, args.joint, args.keyframe)
    if not any((*flags, args.start, args.end, args.loop_pose, args.constraints)):
        return []
    from kinegraph.constraints import EndPose, Loop, StartPose
    from kinegraph.formats import constraints_json, read

    made: list[Constraint] = []
    for flag, texts, parse in (
        ("--path", args.path, _path),
        ("--waypoint", args.waypoint, _waypoint),
        ("--hand", args.hand, _hand),
        ("--foot", args.foot, _foot),
        ("--joint", args.joint, _joint),
        ("--keyframe", args.keyframe, _keyframe),
    ):
        for text in texts:
            try:
                made.append(parse(text))
            except InvalidInputError as error:
                raise InvalidInputError(f"{flag} {text[:80]!r}: {error}") from error
    if args.start is not None:
        made.append(StartPose(read(args.start)))  # type: ignore[arg-type]
    if args.end is not None:
        made.append(EndPose(read(args.end)))  # type: ignore[arg-type]
    if args.loop_pose:
        made.append(Loop())
    if args.constraints is not None:
        made += constraints_json.read(args.constraints)
    return made


def describe_misses(misses: Sequence[Miss]) -> list[str]:
    """Say in one line each how far a clip is from its constraints."""
    lines = []
    for miss in misses:
        worst = "" if _length(miss.worst) == _length(miss.metres) else f", {_length(miss.worst)} at worst"
        turn = "" if miss.degrees is None else f", heading {miss.degrees:.0f} degrees"
        lines.append(f"{miss.what}: missed by {_length(miss.metres)}{worst}{turn}")
    return lines


def miss_records(misses: Sequence[Miss]) -> list[dict[str, Any]]:
    """Convert misses to JSON."""
    return [miss.to_dict() for miss in misses]


def _length(metres: float) -> str:
    return f"{1000 * metres:.0f} mm" if metres < 0.0995 else f"{metres:.2f} m"


def _path(text: str) -> Constraint:
    from kinegraph.constraints import Path

    points, times = [], []
    for word in text.split():
        place, at, time = word.partition("@")
        points.append(_numbers(place, "x,z", 2))
        times += [_moment(time)] if at else []
    if times and len(times) != len(points):
        raise InvalidInputError(f"{len(times)} times for {len(points)} points; give a time to each or to none")
    return Path(points, times or None)  # type: ignore[arg-type]


def _waypoint(text: str) -> Waypoint:
    from kinegraph.constraints import Waypoint

    time, place = _split(text, "=", "TIME=X,Z, e.g. 2.5s=1,2")
    x, z, *heading = _numbers(place, "x,z or x,z,heading", 2, 3)
    return Waypoint(_moment(time), (x, z), *heading)


def _hand(text: str) -> Constraint:
    return _limb(text, "hand")


def _foot(text: str) -> Constraint:
    return _limb(text, "foot")


def _limb(text: str, limb: str) -> Constraint:
    side, target = _split(text, "@", f"SIDE@TIME=X,Y,Z, e.g. right@2s=.3,1.5,.4 for a {limb}")
    if side.strip().lower() not in ("left", "right"):
        raise InvalidInputError(f"the side is left or right, not {side[:40]!r}")
    return _joint(f"{side.strip()} {limb}@{target}")


def _joint(text: str) -> Constraint:
    from kinegraph.constraints import JointTarget

    joint, target = _split(text, "@", "NAME@TIME=X,Y,Z, e.g. head@2s=_,1.2,_")
    time, place = _split(target, "=", "NAME@TIME=X,Y,Z, e.g. head@2s=_,1.2,_")
    position = [None if word.strip() == _FREE else word for word in place.split(",")]
    numbers = tuple(None if word is None else _number(word) for word in position)
    return JointTarget(joint, numbers, parse_interval(time))  # type: ignore[arg-type]


def _keyframe(text: str) -> Constraint:
    from kinegraph.constraints import Keyframe
    from kinegraph.formats import read

    time, pose = _split(text, "=", "TIME=CLIP@TIME, e.g. 2s=bow.npz@1.5s")
    file, at, moment = pose.rpartition("@")
    if not at:
        raise InvalidInputError("write TIME=CLIP@TIME, e.g. 2s=bow.npz@1.5s")
    return Keyframe.of(read(file), _moment(moment), at=_moment(time))


def _split(text: str, separator: str, form: str) -> tuple[str, str]:
    before, found, after = text.partition(separator)
    if not found:
        raise InvalidInputError(f"write {form}")
    return before, after


def parse_interval(text: str) -> float | tuple[float, float]:
    """Read a moment "2.5s", or a while "2-3s".

    Raises:
        InvalidInputError: neither.
    """
    found = _SECONDS.fullmatch(text)
    if found is None:
        raise InvalidInputError(f"{text[:40]!r} is no time; write 2.5s, or 2-3s for a while")
    begin, end = found.groups()
    return _number(begin) if end is None else (_number(begin), _number(end))


def _moment(text: str) -> float:
    interval = parse_interval(text)
    if isinstance(interval, tuple):
        raise InvalidInputError(f"{text[:40]!r} is a while; write one moment, e.g. 2.5s")
    return interval


def _numbers(text: str, form: str, *counts: int) -> list[float]:
    words = text.split(",")
    if len(words) not in counts:
        raise InvalidInputError(f"{text[:40]!r} is not {form} in metres")
    return [_number(word) for word in words]


def _number(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InvalidInputError(f"{text[:40]!r} is no number")
    return number
