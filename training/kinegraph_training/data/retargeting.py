"""Retargeting by joint names: the 22 joints of `kinegraph.motion.skeleton` from other skeletons.

A joint is taken from a source joint, from its End Site (`"Foot.end"`), or from a point on the line between two source
joints (`("Hips", "Spine", 0.5)` is half way). Names are compared without case, separators and prefixes such as
`mixamorig:`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES
from kinegraph_training.data.bvh import END

Point = tuple[str, str, float]
Source = str | Point
"""Name of a source joint, or a point between two."""

_PREFIX: Final = re.compile(r"^(mixamorig\d*|ccbase|mavg|favg|bip0*1)(?=.)")


def _both_sides(middle: dict[str, str], sided: dict[str, str]) -> dict[str, tuple[str, ...]]:
    """Expand a table of names; `{side}` becomes left or right, `{s}` l or r, and `|` separates alternatives."""
    table = {joint: tuple(names.split("|")) for joint, names in middle.items()}
    for joint, names in sided.items():
        for side in ("left", "right"):
            table[f"{side}_{joint}"] = tuple(names.format(side=side, s=side[0]).split("|"))
    return table


_MIXAMO_LIMBS: Final = {
    "hip": "{side}upleg",
    "knee": "{side}leg",
    "ankle": "{side}foot",
    "foot": "{side}toebase|{side}toe|{side}foot.end",
    "collar": "{side}shoulder",
    "shoulder": "{side}arm",
    "elbow": "{side}forearm",
    "wrist": "{side}hand",
}

NAMING_CONVENTIONS: Final[dict[str, dict[str, tuple[str, ...]]]] = {
    "SMPL": _both_sides(
        {joint: joint.replace("_", "") for joint in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")},
        {part: f"{{side}}{part}|{{s}}{part}" for part in ("hip", "knee", "ankle", "collar", "shoulder", "elbow")}
        | {"foot": "{side}foot|{s}foot|{side}toe|{s}toe", "wrist": "{side}wrist|{s}wrist"},
    ),
    "CMU": _both_sides(
        {
            "pelvis": "hips",
            "spine1": "lowerback",
            "spine2": "spine",
            "spine3": "spine1",
            "neck": "neck",
            "head": "head",
        },
        _MIXAMO_LIMBS,
    ),
    "Mixamo, LaFAN1": _both_sides(
        {
            "pelvis": "hips",
            "spine1": "spine",
            "spine2": "spine1",
            "spine3": "spine2",
            "neck": "neck",
            "head": "head",
        },
        _MIXAMO_LIMBS,
    ),
    "Bandai Namco": _both_sides(
        {"pelvis": "hips", "spine2": "spine", "spine3": "chest", "neck": "neck", "head": "head"},
        {
            "hip": "upperleg{s}",
            "knee": "lowerleg{s}",
            "ankle": "foot{s}",
            "foot": "toes{s}|foot{s}.end",
            "collar": "shoulder{s}",
            "shoulder": "upperarm{s}",
            "elbow": "lowerarm{s}",
            "wrist": "hand{s}",
        },
    ),
    "cgspeed": _both_sides(
        {"pelvis": "hip", "spine1": "abdomen", "spine2": "chest", "neck": "neck", "head": "head"},
        {
            "hip": "{s}thigh",
            "knee": "{s}shin",
            "ankle": "{s}foot",
            "foot": "{s}toe|{s}foot.end",
            "collar": "{s}collar",
            "shoulder": "{s}shldr",
            "elbow": "{s}forearm",
            "wrist": "{s}hand",
        },
    ),
    "Character Creator": _both_sides(
        {
            "pelvis": "hip",
            "spine1": "waist",
            "spine2": "spine01",
            "spine3": "spine02",
            "neck": "necktwist01",
            "head": "head",
        },
        {
            "hip": "{s}thigh",
            "knee": "{s}calf",
            "ankle": "{s}foot",
            "foot": "{s}toebase|{s}foot.end",
            "collar": "{s}clavicle",
            "shoulder": "{s}upperarm",
            "elbow": "{s}forearm",
            "wrist": "{s}hand",
        },
    ),
}
"""By naming convention and joint: names that the joint may have, without case, separators and prefix."""

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
    for name in names:
        known.setdefault(plain_name(name), name)
    overriding = {joint: _resolve(joint, source, known) for joint, source in (overrides or {}).items()}
    sources: dict[str, dict[str, Source]] = {}
    for convention, table in NAMING_CONVENTIONS.items():
        hits = (
            (joint, next((known[name] for name in wanted if name in known), None)) for joint, wanted in table.items()
        )
        sources[convention] = {**{joint: name for joint, name in hits if name is not None}, **overriding}
    convention = max(sources, key=lambda candidate: len(sources[candidate]))
    missing = [joint for joint in JOINT_NAMES if joint not in sources[convention] and joint not in OPTIONAL]
    if missing:
        raise InvalidInputError(
            f"no joint found for {', '.join(missing)} (closest naming: {convention}). The file has "
            f"{', '.join(name for name in names if not name.endswith(END))}. Write a map file, for example "
            f'{{"{missing[0]}": "NAME IN THE FILE"}}, and pass it with --map'
        )
    return JointMap(convention, sources[convention])


def read_map(path: Path) -> dict[str, Source]:
    """Read a map file: a JSON object of joints, each with a source joint or [joint, joint, share].

    Raises:
        InvalidInputError: no such file, no JSON, an unknown joint, or another kind of entry.
    """
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read ({error.strerror}); check the name") from error
    except ValueError as error:
        raise InvalidInputError(f"{path} is no JSON ({error})") from error
    if not isinstance(entries, dict):
        raise InvalidInputError(f'{path} must be an object such as {{"pelvis": "Hips"}}')
    unknown = [joint for joint in entries if joint not in JOINT_INDEX]
    if unknown:
        raise InvalidInputError(f"{path} maps {', '.join(unknown)}; joints are {', '.join(JOINT_NAMES)}")
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


def plain_name(name: str) -> str:
    """Strip case, separators, name space (`rig:`) and known prefixes; an End Site keeps its `.end`."""
    body, end = (name[: -len(END)], END) if name.endswith(END) else (name, "")
    plain = re.sub(r"[\W_]+", "", body.rpartition(":")[2].lower())
    return _PREFIX.sub("", plain) + end


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
        case [str() as start, str() as end, int() | float() as share] if not isinstance(share, bool):
            return start, end, float(share)
    raise InvalidInputError(f'{path}: {joint} is {entry!r}; it must be "NAME" or ["NAME", "NAME", 0.5]')


def _resolve(joint: str, source: Source, known: Mapping[str, str]) -> Source:
    """Translate the names of a map entry into those of the file."""
    wanted = (source,) if isinstance(source, str) else source[:2]
    names = [known.get(plain_name(name)) for name in wanted]
    for name, hit in zip(wanted, names, strict=True):
        if hit is None:
            raise InvalidInputError(
                f"the map takes {joint} from {name!r}, which the file lacks; it has {', '.join(known.values())}"
            )
    resolved = [name for name in names if name is not None]
    return resolved[0] if isinstance(source, str) else (resolved[0], resolved[1], source[2])
