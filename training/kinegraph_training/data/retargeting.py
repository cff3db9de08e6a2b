"""Retargeting by joint names: the 22 joints of `kinegraph.motion.skeleton` from other skeletons.

A joint is taken from a source joint, from its End Site (`"Foot.end"`), or from a point on the line between two source
joints (`("Hips", "Spine", 0.5)` is half way). Names are compared in the plain form of `naming`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, JOINTS, PARENTS, bone_lengths
from kinegraph.validation import finite_number, short_repr
from kinegraph_training.data.naming import END, NAMING_CONVENTIONS, plain_name, strip_common_prefix
from kinegraph_training.data.recording import read_bytes

Point = tuple[str, str, float]
Source = str | Point
"""Name of a source joint, or a point between two."""

SHORTEST_BONE: Final = 0.003
"""Length of a bone, as a share of all 21 together, below which its joints lie on each other: 1.4 cm of an adult."""

_MAX_LISTED: Final = 80
"""Names that an error message lists."""

OPTIONAL: Final = frozenset({"spine1", "spine2", "spine3", "left_collar", "right_collar"})
"""Joints that are interpolated between their neighbours where a skeleton lacks them."""


@dataclass(frozen=True)
class JointMap:
    """Sources of the 22 joints among the joints of one file."""

    convention: str
    """Naming convention that fitted best."""
    sources: Mapping[str, Source]
    """By joint, in the names of the file; joints of `OPTIONAL` may be missing."""


def find_joint_map(names: tuple[str, ...], overrides: Mapping[str, Source] | None = None) -> JointMap:
    """Find the sources of the 22 joints by the naming convention that fits best.

    Args:
        names: of the source joints, End Sites as `Foot.end`.
        overrides: entries of a map file (`read_map`), which come before those of the convention.

    Raises:
        InvalidInputError: joints that are not optional have no source; the message names them.
    """
    known: dict[str, str] = {}
    for form in (strip_common_prefix(names), names):
        for name, short in zip(names, form, strict=True):
            known.setdefault(plain_name(short), name)
    overriding = {joint: _resolve(joint, source, known, names) for joint, source in (overrides or {}).items()}
    sources: dict[str, dict[str, Source]] = {}
    for convention, table in NAMING_CONVENTIONS.items():
        hits = (
            (joint, next((known[name] for name in wanted if name in known), None)) for joint, wanted in table.items()
        )
        found: dict[str, Source] = {**{joint: name for joint, name in hits if name is not None}, **overriding}
        sources[convention] = _toes_from_ends(found, names)
    convention = max(sources, key=lambda candidate: len(sources[candidate]))
    missing = [joint for joint in JOINT_NAMES if joint not in sources[convention] and joint not in OPTIONAL]
    if missing:
        raise InvalidInputError(
            f"no joint found for {', '.join(missing)} (closest naming: {convention}). The file has "
            f"{list_names(names)} (NAME{END} is the End Site of NAME, and can be mapped). Write a map file, for "
            f'example {{"{missing[0]}": "NAME IN THE FILE"}}, and pass it with --map'
        )
    return JointMap(convention, sources[convention])


def list_names(names: Sequence[str]) -> str:
    """List names for a message, End Sites left out, at most `_MAX_LISTED` of them."""
    listed = [name[:60] for name in names if not name.endswith(END)]
    more = len(listed) - _MAX_LISTED
    return ", ".join(listed[:_MAX_LISTED]) + (f" and {more} more" if more > 0 else "")


def without_zero_length(joint_map: JointMap, positions: Floats, names: tuple[str, ...]) -> tuple[JointMap, list[str]]:
    """Drop sources of `OPTIONAL` joints that lie on a neighbour: CMU's LowerBack lies on the Hips, its Neck on Spine1.

    Args:
        joint_map: of `find_joint_map`.
        positions: (frames, n, 3) of the source joints.
        names: of the n source joints.

    Returns:
        The map, and the joints that it no longer has.
    """
    joints = map_joints(positions, names, joint_map)
    lengths = bone_lengths(joints).mean(axis=0)
    shortest = SHORTEST_BONE * lengths.sum()
    dropped: list[str] = []
    for child in range(1, JOINTS):
        ends = (JOINT_NAMES[child], JOINT_NAMES[PARENTS[child]])
        if lengths[child - 1] < shortest and not any(joint in dropped for joint in ends):
            dropped += [joint for joint in ends if joint in OPTIONAL and joint in joint_map.sources][:1]
    kept = {joint: source for joint, source in joint_map.sources.items() if joint not in dropped}
    return replace(joint_map, sources=kept), dropped


def read_map(path: Path) -> dict[str, Source]:
    """Read a map file: a JSON object of joints, each with a source joint or [joint, joint, share].

    Raises:
        InvalidInputError: no such file, no JSON, an unknown joint, or another kind of entry.
    """
    try:
        entries = json.loads(read_bytes(path).decode("utf-8-sig"))
    except InvalidInputError as error:
        raise InvalidInputError(f"{path}: {error}") from error
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"{path} is no JSON ({str(error)[:200]})") from error
    if not isinstance(entries, dict):
        raise InvalidInputError(f'{path} must be an object such as {{"pelvis": "Hips"}}')
    unknown = [joint for joint in entries if joint not in JOINT_INDEX]
    if unknown:
        raise InvalidInputError(f"{path} maps {', '.join(unknown[:10])!r}; joints are {', '.join(JOINT_NAMES)}")
    return {joint: _parse_source(path, joint, entry) for joint, entry in entries.items()}


def map_joints(positions: Floats, names: tuple[str, ...], joint_map: JointMap) -> Floats:
    """Map source joints to the 22 joints, in the same units and axes.

    Args:
        positions: (frames, n, 3).
        names: of the n source joints.
        joint_map: of `find_joint_map`.

    Returns:
        (frames, 22, 3).
    """
    index = {name: number for number, name in reversed(list(enumerate(names)))}
    joints: dict[str, Floats] = {}
    for joint, source in joint_map.sources.items():
        if isinstance(source, str):
            joints[joint] = positions[:, index[source]]
        else:
            start, end, share = source
            joints[joint] = _interpolate(positions[:, index[start]], positions[:, index[end]], share)
    _fill_spine(joints)
    for side in ("left", "right"):
        if f"{side}_collar" not in joints:
            joints[f"{side}_collar"] = _interpolate(joints["neck"], joints[f"{side}_shoulder"], 0.4)
    return np.stack([joints[joint] for joint in JOINT_NAMES], axis=1)


def _toes_from_ends(sources: dict[str, Source], names: tuple[str, ...]) -> dict[str, Source]:
    """Take toes that a skeleton lacks from the End Sites of its ankles."""
    for side in ("left", "right"):
        ankle, end = sources.get(f"{side}_ankle"), f"{sources.get(f'{side}_ankle')}{END}"
        if isinstance(ankle, str) and f"{side}_foot" not in sources and end in names:
            sources[f"{side}_foot"] = end
    return sources


def _fill_spine(joints: dict[str, Floats]) -> None:
    """Put missing joints of the spine on the line between those it has."""
    if "spine3" not in joints:
        below, share = ("spine2", 0.25) if "spine2" in joints else ("spine1", 0.5)
        start = joints[below] if below in joints else _interpolate(joints["pelvis"], joints["neck"], 0.2)
        joints["spine3"] = _interpolate(start, joints["neck"], share)
    if "spine2" not in joints:
        start = joints["spine1"] if "spine1" in joints else _interpolate(joints["pelvis"], joints["neck"], 0.2)
        joints["spine2"] = _interpolate(start, joints["spine3"], 0.5)
    if "spine1" not in joints:
        joints["spine1"] = _interpolate(joints["pelvis"], joints["spine2"], 0.5)


def _interpolate(start: Floats, end: Floats, share: float) -> Floats:
    return np.asarray(start + share * (end - start))


def _parse_source(path: Path, joint: str, entry: object) -> Source:
    match entry:
        case str():
            return entry
        case [str() as start, str() as end, int() | float() as share] if finite_number(share) is not None:
            return start, end, float(share)
    raise InvalidInputError(f'{path}: {joint} is {short_repr(entry)}; it must be "NAME" or ["NAME", "NAME", 0.5]')


def _resolve(joint: str, source: Source, known: Mapping[str, str], names: tuple[str, ...]) -> Source:
    """Translate the names of a map entry into those of the file: the very name, or one of the same plain form."""
    wanted = (source,) if isinstance(source, str) else source[:2]
    hits = [name if name in names else known.get(plain_name(name)) for name in wanted]
    for name, hit in zip(wanted, hits, strict=True):
        if hit is None:
            raise InvalidInputError(
                f"the map takes {joint} from {name[:60]!r}, which the file lacks; it has {list_names(names)}"
            )
    resolved = [name for name in hits if name is not None]
    return resolved[0] if isinstance(source, str) else (resolved[0], resolved[1], source[2])
