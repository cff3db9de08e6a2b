"""Names of joints in the files of other programs, by naming convention.

Names are compared in a plain form: no name space, no prefix, no case, no separators, the side as a word of its own in
front. So `mixamorig:LeftUpLeg` and `l_upLeg_JNT` are both `left upleg`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

END: Final = ".end"
"""Suffix of the name of an End Site: `Head.end` is that of `Head`."""

_PREFIX: Final = re.compile(
    r"^(mixamorig\d*[_ ]?|character\d+_|cc_base_|valvebiped\.|bip0*\d{1,2}[_ ]?|robot_|def-|org-|j_bip_c_|j_bip_"
    r"|[mf]_avg_)(?=.)",
    re.IGNORECASE,
)
_SUFFIX: Final = re.compile(r"(?<=.)_(jnt|joint|bone)$", re.IGNORECASE)
_WORD: Final = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+|[^\W\d_a-zA-Z]+")
_SIDES: Final = {"left": "left", "l": "left", "right": "right", "r": "right"}

_LEG_ARM: Final = ("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist")
_SPINE: Final = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")


def _names(middle: str, sided: str) -> dict[str, tuple[str, ...]]:
    """Read a table: names in the order of `_SPINE` and `_LEG_ARM`, alternatives with `|`, `-` for a joint it lacks."""
    table = {joint: names for joint, names in zip(_SPINE, middle.split(), strict=True) if names != "-"}
    for joint, names in zip(_LEG_ARM, sided.split(), strict=True):
        for side in ("left", "right"):
            table[f"{side}_{joint}"] = "|".join(f"{side} {name}" for name in names.split("|"))
    return {joint: tuple(names.split("|")) for joint, names in table.items()}


_MIXAMO: Final = "upleg leg foot toebase|toe shoulder arm forearm hand"
_HUMANOID: Final = "upperleg lowerleg foot toes|toebase|toe shoulder upperarm lowerarm hand"

NAMING_CONVENTIONS: Final[dict[str, dict[str, tuple[str, ...]]]] = {
    "SMPL": _names(
        "pelvis spine1|torso spine2|spine spine3|chest neck head",
        "hip knee ankle foot|toe collar|thorax shoulder elbow wrist",
    ),
    "CMU": _names("hips lowerback spine spine1 neck head", _MIXAMO),
    "Mixamo, LaFAN1, Perception Neuron": _names("hips spine spine1 spine2 neck|neck1 head", _MIXAMO),
    "Bandai Namco": _names("hips - spine chest neck head", _HUMANOID),
    "Unity, VRM": _names("hips spine chest upperchest neck head", _HUMANOID),
    "Rokoko": _names("hips spine1 spine2 spine4|spine3 neck head", "thigh shin foot toe shoulder arm forearm hand"),
    "Biovision, Xsens, 100STYLE": _names(
        "hips chest chest2 chest4|chest3 neck head", "hip knee ankle toe|toebase collar shoulder elbow wrist"
    ),
    "Xsens segments": _names(
        "pelvis l5 l3|t12 t8 neck head", "upperleg lowerleg foot toe shoulder upperarm forearm hand"
    ),
    "Biped": _names(
        "pelvis spine spine1 spine3|spine2 neck head", "thigh calf foot toe0|toe clavicle upperarm forearm hand"
    ),
    "Unreal": _names(
        "pelvis spine01 spine02 spine05|spine03 neck01 head", "thigh calf foot ball clavicle upperarm lowerarm hand"
    ),
    "Rigify": _names(
        "spine|hips spine001 spine002 spine003 spine004|neck spine006|spine005|head",
        "thigh shin foot toe shoulder upperarm forearm hand",
    ),
    "cgspeed": _names("hip abdomen chest - neck head", "thigh shin foot toe collar shldr forearm hand"),
    "Daz Genesis": _names(
        "pelvis|hip abdomenlower|abdomen abdomenupper|abdomen2 chestlower|chest necklower|neck head",
        "thighbend|thigh shin foot toe collar shldrbend|shldr forearmbend|forearm hand",
    ),
    "Daz Genesis 9": _names(
        "pelvis|hip spine1 spine2 spine4|spine3 neck1 head", "thigh shin foot toes shoulder upperarm forearm hand"
    ),
    "Character Creator": _names(
        "hip|pelvis waist spine01 spine02 necktwist01 head", "thigh calf foot toebase clavicle upperarm forearm hand"
    ),
    "SOMA": _names("hips spine1 spine2 chest neck1|neck head", "leg shin foot toebase|toe shoulder arm forearm hand"),
    "MakeHuman": _names(
        "hip|hips abdomen|lowerback chest|spine spine1 neck head", "hip knee foot toe1|toe11 collar shoulder elbow hand"
    ),
    "MakeHuman default": _names(
        "root spine05 spine03|spine04 spine02 neck01 head",
        "upperleg01 lowerleg01 foot toe11 clavicle upperarm01 lowerarm01 wrist",
    ),
    "CMU bones": _names(
        "root|hips lowerback upperback thorax lowerneck head",
        "femur tibia foot toes clavicle humerus radius wrist|hand",
    ),
    "OptiTrack": _names("hip ab - chest neck head", "thigh shin foot toe shoulder uarm farm hand"),
}
"""By naming convention and joint: plain names that the joint may have, the likeliest first."""

_SIDED: Final = frozenset(
    name.partition(" ")[2]
    for table in NAMING_CONVENTIONS.values()
    for joint, names in table.items()
    if joint.startswith("left")
    for name in names
)
"""Names of limbs, without the side: `lthigh` is the left thigh, while `lowerback` is no `owerback`."""


def plain_name(name: str) -> str:
    """Bring a name into the plain form; an End Site keeps its `.end`."""
    body, end = (name[: -len(END)], END) if name.endswith(END) else (name, "")
    body = re.split(r"[:|]", body)[-1]
    for _ in range(2):  # ValveBiped.Bip01_
        body = _PREFIX.sub("", body)
    words = [word.lower() for word in _WORD.findall(_SUFFIX.sub("", body))]
    at = next((number for number, word in enumerate(words) if word in _SIDES), None)
    rest = "".join(words[:at] + words[at + 1 :]) if at is not None else ""
    if at is not None and rest and not rest.isdigit():  # L5 is a vertebra
        return f"{_SIDES[words[at]]} {rest}{end}"
    return _split_side("".join(words)) + end


def strip_common_prefix(names: Sequence[str]) -> list[str]:
    """Strip what all names begin with, up to a separator: the name of the character, mostly."""
    # all names lie between the first and the last in order, and so share what these two share
    first, last = min(names, default=""), max(names, default="")
    shared = next((at for at, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), 0)
    common = first[:shared]
    length = max((common.rfind(separator) for separator in "_:-. |"), default=-1) + 1
    return [name[length:] for name in names]


def _split_side(name: str) -> str:
    """Find the side in a name whose words are not told apart: `leftupleg`, `lthigh`, `upperlegl`."""
    for word, side in _SIDES.items():
        for rest in (name.removeprefix(word), name.removesuffix(word)):
            if rest != name and (rest in _SIDED or (len(word) > 1 and rest)):
                return f"{side} {rest}"
    return name
