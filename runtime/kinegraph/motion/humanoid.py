"""Which node of a character is which joint of ours: by the names of its rig, by the shape of its hierarchy, or as told.

Names are split into a side and a part ("mixamorig:LeftUpLeg", "upperarm_l", "DEF-thigh.L", "J_Bip_R_Hand"). A rig is
known if one of `CONVENTIONS` has every limb in it. Only limbs and head go by name: the pelvis is where both legs and
the head meet, the chest where both arms and the head meet, and the spine is what lies between.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from kinegraph.errors import InvalidInputError
from kinegraph.motion.rig import Rig
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph.validation import short_repr

SIDES: Final = ("left", "right")
LIMB_JOINTS: Final = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
"""Joints of ours that a human must have on both sides."""
_SPINE: Final = ("spine1", "spine2", "spine3")

CONVENTIONS: Final[dict[str, dict[str, tuple[str, ...]]]] = {
    "Mixamo": {
        "hip": ("upleg",), "knee": ("leg",), "ankle": ("foot",), "foot": ("toebase", "toe"), "collar": ("shoulder",),
        "shoulder": ("arm",), "elbow": ("forearm",), "wrist": ("hand",),
    },
    "SOMA": {
        "hip": ("leg",), "knee": ("shin",), "ankle": ("foot",), "foot": ("toebase",), "collar": ("shoulder",),
        "shoulder": ("arm",), "elbow": ("forearm",), "wrist": ("hand",),
    },
    "SMPL": {
        "hip": ("hip",), "knee": ("knee",), "ankle": ("ankle",), "foot": ("foot",), "collar": ("collar",),
        "shoulder": ("shoulder",), "elbow": ("elbow",), "wrist": ("wrist",),
    },
    "Unity or VRM": {
        "hip": ("upperleg",), "knee": ("lowerleg",), "ankle": ("foot",), "foot": ("toes", "toe", "toebase"),
        "collar": ("shoulder",), "shoulder": ("upperarm",), "elbow": ("lowerarm",), "wrist": ("hand",),
    },
    "Unreal": {
        "hip": ("thigh",), "knee": ("calf",), "ankle": ("foot",), "foot": ("ball",), "collar": ("clavicle",),
        "shoulder": ("upperarm",), "elbow": ("lowerarm",), "wrist": ("hand",),
    },
    "Character Creator or Biped": {
        "hip": ("thigh",), "knee": ("calf",), "ankle": ("foot",), "foot": ("toebase", "toe0"), "collar": ("clavicle",),
        "shoulder": ("upperarm",), "elbow": ("forearm",), "wrist": ("hand",),
    },
    "Rigify": {
        "hip": ("thigh",), "knee": ("shin",), "ankle": ("foot",), "foot": ("toe",), "collar": ("shoulder",),
        "shoulder": ("upperarm",), "elbow": ("forearm",), "wrist": ("hand",),
    },
    "MakeHuman": {
        "hip": ("upperleg01",), "knee": ("lowerleg01",), "ankle": ("foot",), "foot": ("toe11",),
        "collar": ("clavicle",), "shoulder": ("upperarm01",), "elbow": ("lowerarm01",), "wrist": ("wrist",),
    },
    "Daz": {
        "hip": ("thighbend", "thigh"), "knee": ("shin",), "ankle": ("foot",), "foot": ("toe",), "collar": ("collar",),
        "shoulder": ("shldrbend", "shldr"), "elbow": ("forearmbend", "forearm"), "wrist": ("hand",),
    },
}  # fmt: skip
"""Rig -> joint of one side -> parts it may be called."""

VRM_BONES: Final[dict[str, str]] = {
    "pelvis": "hips", "spine1": "spine", "spine2": "chest", "spine3": "upperChest", "neck": "neck", "head": "head",
} | {
    f"{side}_{joint}": side + bone
    for side in SIDES
    for joint, bone in (
        ("hip", "UpperLeg"), ("knee", "LowerLeg"), ("ankle", "Foot"), ("foot", "Toes"), ("collar", "Shoulder"),
        ("shoulder", "UpperArm"), ("elbow", "LowerArm"), ("wrist", "Hand"),
    )
}  # fmt: skip
"""Joint -> bone of VRM's humanoid (VRM Consortium, VRMC_vrm 1.0, humanoid.md)."""

_TWO: Final = "it holds two skeletons; keep one character in the file"
_PREFIXES: Final = frozenset(
    ("mixamorig", "mixamo", "cc", "base", "j", "bip", "c", "def", "armature", "bone", "joint", "valve", "biped", "rig")
)
_WORDS: Final = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
_SIDE_WORDS: Final = {"l": "left", "left": "left", "r": "right", "right": "right"}


@dataclass(frozen=True)
class Humanoid:
    """The nodes of a rig that follow our joints."""

    bones: Mapping[str, int]
    """Joint of `JOINT_NAMES` but spine1 to spine3 -> node; feet (toes), collars, neck and head may be missing."""
    spine: tuple[int, ...]
    """Nodes between pelvis and neck from the bottom up; the last is the chest."""
    found_by: str
    """Name of the rig, "VRM", "shape of the hierarchy" or "map"."""


def find_humanoid(
    rig: Rig, *, vrm: Mapping[str, int] | None = None, names: Mapping[str, str] | None = None
) -> Humanoid:
    """Find the nodes that follow our joints.

    Args:
        rig: of the character.
        vrm: bone of VRM's humanoid -> node, of a file that has it; then names are not read.
        names: joint of `JOINT_NAMES` -> name of a node, where the caller knows better.

    Raises:
        InvalidInputError: limbs are missing (they are named), a name is there twice, there are two skeletons, or
            `names` has a joint or a node that does not exist.
    """
    told = _told(rig, names or {})
    if vrm is not None:
        bones = {joint: vrm[bone] for joint, bone in VRM_BONES.items() if bone in vrm} | told
        if missing := [joint for joint in _needed() if joint not in bones]:
            raise InvalidInputError(
                f"its VRM humanoid lacks {', '.join(VRM_BONES[joint] for joint in missing)}; export it again with all "
                "bones that VRM requires"
            )
        return _assembled(rig, bones, "VRM")
    named, convention = _by_name(rig, told)
    if not (missing := _missing(named)):
        others = (skin for skin in _separate(rig)[:-1] if named["left_hip"] not in skin)
        if any(_by_shape(rig, skin) for skin in others):
            raise InvalidInputError(_TWO)
        return _assembled(rig, named, "map" if all(joint in told for joint in _needed()) else convention)
    shaped = [bones for bones in (_by_shape(rig, skin) for skin in _separate(rig)) if bones]
    if len(shaped) > 1:
        raise InvalidInputError(_TWO)
    if not shaped:
        raise InvalidInputError(
            f"it is not a human that kinegraph knows: no joint for {', '.join(missing)}; name them in a map "
            '(--map FILE, {"left_hip": "name of the joint", ...})'
        )
    return _assembled(rig, shaped[0] | told, "shape of the hierarchy")


def split_name(name: str) -> tuple[str, str]:
    """Split the name of a joint into its side ("left", "right" or "") and its part in small letters.

    >>> split_name("mixamorig:LeftUpLeg"), split_name("CC_Base_R_Upperarm"), split_name("neck_01")
    (('left', 'upleg'), ('right', 'upperarm'), ('', 'neck01'))
    """
    words = [word.lower() for word in _WORDS.findall(re.split(r"[:|]", name)[-1])]
    while len(words) > 1 and (words[0] in _PREFIXES or words[0].isdigit()):
        words = words[1:]
    for index, word in enumerate(words):
        if word in _SIDE_WORDS and len(words) > 1:
            return _SIDE_WORDS[word], "".join(words[:index] + words[index + 1 :])
    whole = "".join(words)
    side = next((side for side in SIDES if whole.startswith(side) and len(whole) > len(side)), "")
    return side, whole.removeprefix(side)


def _needed() -> list[str]:
    return [f"{side}_{joint}" for side in SIDES for joint in LIMB_JOINTS]


def _missing(bones: Mapping[str, int]) -> list[str]:
    missing = [joint for joint in _needed() if joint not in bones]
    return missing if "head" in bones or "neck" in bones else [*missing, "head"]


def _told(rig: Rig, names: Mapping[str, str]) -> dict[str, int]:
    """Look up the nodes of a caller's map."""
    bones = {}
    for joint, name in names.items():
        if joint not in JOINT_INDEX:
            raise InvalidInputError(f"the map has {short_repr(joint)}; joints are {', '.join(JOINT_INDEX)}")
        nodes = [node for node, given in enumerate(rig.names) if given == name]
        if len(nodes) != 1:
            known = ", ".join(rig.names[node] for node in sorted(rig.joints)[:60])
            count = "no node" if not nodes else f"{len(nodes)} nodes"
            raise InvalidInputError(f"the map has {short_repr(name)} for {joint}: {count} of that name among {known}")
        bones[joint] = nodes[0]
    return bones


def _by_name(rig: Rig, told: Mapping[str, int]) -> tuple[dict[str, int], str]:
    """Find the joints by the convention that knows the most of them.

    Raises:
        InvalidInputError: the best convention has two nodes for a joint.
    """
    parts: dict[tuple[str, str], list[int]] = {}
    for node in range(len(rig.names)):
        if node in rig.joints or any(child in rig.joints for child in rig.children[node]):
            parts.setdefault(split_name(rig.names[node]), []).append(node)
    best: dict[str, list[int]] = {}
    chosen = ""
    for convention, slots in CONVENTIONS.items():
        found = {
            f"{side}_{joint}": nodes
            for side in SIDES
            for joint, accepted in slots.items()
            if (nodes := next((parts[side, part] for part in accepted if (side, part) in parts), []))
        }
        if len(found) > len(best):
            best, chosen = found, convention
    for joint, accepted in (("neck", ("neck", "neck01", "neck1", "necktwist01", "necklower")), ("head", ("head",))):
        if nodes := next((parts["", part] for part in accepted if ("", part) in parts), []):
            best[joint] = nodes
    bones = {joint: _only(rig, joint, nodes) for joint, nodes in best.items() if joint not in told} | dict(told)
    arms = [
        bones[f"{side}_{joint}"] for side in SIDES for joint in ("collar", "shoulder") if f"{side}_{joint}" in bones
    ]
    if "neck" not in bones and "head" not in bones and len(arms) >= 2 and (chest := rig.common_ancestor(arms)) >= 0:
        bones |= _neck_and_head(rig, chest, arms)
    return bones, chosen


def _neck_and_head(rig: Rig, chest: int, arms: Sequence[int]) -> dict[str, int]:
    """Find neck and head by shape: the branch of the chest that reaches highest, up to where it branches or ends."""
    _, highest, _ = _extents(rig, [node for node in rig.order if node in rig.joints])
    tops = [
        child for child in rig.children[chest] if child in highest and not any(rig.path(child, arm) for arm in arms)
    ]
    if not tops:
        return {}
    neck = max(tops, key=lambda child: rig.positions[highest[child], 1])
    trail = rig.path(neck, highest[neck])
    if len(trail) == 1:
        return {"head": neck}
    forks = (node for node in trail[1:] if len(rig.children[node]) != 1)
    head = next(forks, trail[-1])
    return {"neck": neck, "head": trail[-2] if head == trail[-1] and len(trail) > 2 else head}


def _only(rig: Rig, joint: str, nodes: Sequence[int]) -> int:
    """Return the one node of a joint: that of a skin before one that is not, and else the one above the others."""
    bound = [node for node in nodes if node in rig.joints] or list(nodes)
    top = [node for node in bound if not any(above in bound for above in rig.ancestors(rig.parents[node]))]
    if len(top) == 1:
        return top[0]
    if len({next(index for index, skin in enumerate(_separate(rig)) if node in skin) for node in top}) > 1:
        raise InvalidInputError(
            f"it holds two skeletons: {', '.join(repr(rig.names[node]) for node in top)} are both {joint}; keep one "
            "character in the file"
        )
    raise InvalidInputError(
        f"{' and '.join(repr(rig.names[node]) for node in top[:3])} may both be {joint}; name the right one in a map "
        f'(--map FILE, {{"{joint}": "name of the joint"}})'
    )


def _separate(rig: Rig) -> list[frozenset[int]]:
    """Join skins that share joints or a root of joints: clothes are bound to the same skeleton as the body.

    Nodes that no skin is bound to are the last set, so that every node is in one.
    """
    groups: list[set[int]] = []
    for skin in rig.skins:
        lines = {above for node in skin for above in rig.ancestors(node) if above in rig.joints}
        shared = [group for group in groups if group & lines]
        groups = [group for group in groups if not group & lines] + [lines.union(*shared)]
    rest = set(range(len(rig.names))).difference(*groups)
    return [frozenset(group) for group in (*groups, rest)]


def _assembled(rig: Rig, bones: Mapping[str, int], found_by: str) -> Humanoid:
    """Add pelvis, spine and neck by the hierarchy, and check that limbs hang together.

    Raises:
        InvalidInputError: a joint of a limb is not below the one before.
    """
    for chain in (("hip", "knee", "ankle", "foot"), ("collar", "shoulder", "elbow", "wrist")):
        for side in SIDES:
            limb = [name for joint in chain if (name := f"{side}_{joint}") in bones]
            for upper, lower in pairwise(limb):
                if bones[upper] == bones[lower] or not rig.path(bones[upper], bones[lower]):
                    raise InvalidInputError(
                        f"{rig.names[bones[lower]]!r} ({lower}) is not below {rig.names[bones[upper]]!r} ({upper}); "
                        "name the right joints in a map"
                    )
    top = bones.get("neck", bones.get("head", -1))
    if top < 0:
        raise InvalidInputError("it has no head; name its joint in a map")
    arms = [bones.get(f"{side}_collar", bones[f"{side}_shoulder"]) for side in SIDES]
    legs = [bones[f"{side}_hip"] for side in SIDES]
    pelvis = bones.get("pelvis", rig.common_ancestor([*legs, top, *arms]))
    chest = rig.common_ancestor([top, *arms])
    if pelvis < 0 or pelvis in legs or not rig.path(pelvis, chest):
        raise InvalidInputError("its legs, arms and head do not hang on one pelvis; name it in a map as pelvis")
    joints = {name: node for name, node in bones.items() if name not in _SPINE} | {"pelvis": pelvis}
    between = rig.path(chest, bones["head"])[1:-1] if "head" in bones else ()
    if "neck" not in joints and between:
        joints["neck"] = between[0]
    return Humanoid(joints, rig.path(pelvis, chest)[1:], found_by)


def _by_shape(rig: Rig, skin: frozenset[int]) -> dict[str, int] | None:
    """Find a human by the shape of a tree of joints: two legs to the floor, a head on top, two arms to the sides."""
    joints = [node for node in rig.order if node in skin and node in rig.joints]
    if len(joints) < 12:
        return None
    points = rig.positions
    low, high = points[joints, 1].min(), points[joints, 1].max()
    lowest, highest, widest = _extents(rig, joints)
    for pelvis in reversed(joints):
        below = [child for child in rig.children[pelvis] if child in lowest]
        legs = [child for child in below if points[lowest[child], 1] < low + 0.15 * (high - low)]
        trunks = [
            child for child in below if child not in legs and points[highest[child], 1] > low + 0.8 * (high - low)
        ]
        if len(legs) == 2 and len(trunks) == 1:
            break
    else:
        return None
    chest, arms = _arms(rig, trunks[0], widest)
    if not arms:
        return None
    leg_paths = [rig.path(leg, lowest[leg]) for leg in legs]
    arm_paths = [rig.path(arm, widest[arm]) for arm in arms]
    limbs = [_three(points, path, tip=False) for path in leg_paths] + [_hand_limb(rig, path) for path in arm_paths]
    bones = _neck_and_head(rig, chest, arms)
    if any(limb is None for limb in limbs) or not bones:
        return None
    ahead = sum(points[path[-1]] - points[limb[2]] for path, limb in zip(leg_paths, limbs, strict=False) if limb)
    left = np.cross((0.0, 1.0, 0.0), ahead)
    for pair, names, paths in (
        (limbs[:2], ("hip", "knee", "ankle"), leg_paths),
        (limbs[2:], ("shoulder", "elbow", "wrist"), arm_paths),
    ):
        across = points[pair[0][2]] - points[pair[1][2]]  # type: ignore[index]
        for side, limb, path in zip(SIDES if across @ left > 0 else SIDES[::-1], pair, paths, strict=True):
            bones |= {f"{side}_{name}": node for name, node in zip(names, limb, strict=True)}  # type: ignore[arg-type]
            if names[0] == "shoulder" and path[0] != limb[0]:  # type: ignore[index]
                bones[f"{side}_collar"] = path[0]
            if names[0] == "hip" and (toes := path[path.index(limb[2]) + 1 :]):  # type: ignore[index]
                bones[f"{side}_foot"] = toes[0]
    return bones


def _extents(rig: Rig, joints: Sequence[int]) -> tuple[dict[int, int], dict[int, int], dict[int, int]]:
    """Find, below each joint, the lowest, the highest and the outermost joint."""
    points = rig.positions
    middle = np.median(points[list(joints)][:, [0, 2]], axis=0)
    outwards = np.linalg.norm(points[:, [0, 2]] - middle, axis=-1)
    lowest, highest, widest = ({node: node for node in joints} for _ in range(3))
    for node in reversed(joints):
        parent = rig.parents[node]
        if parent in lowest:
            lowest[parent] = min(lowest[parent], lowest[node], key=lambda end: points[end, 1])
            highest[parent] = max(highest[parent], highest[node], key=lambda end: points[end, 1])
            widest[parent] = max(widest[parent], widest[node], key=lambda end: outwards[end])
    return lowest, highest, widest


def _arms(rig: Rig, trunk: int, widest: Mapping[int, int]) -> tuple[int, list[int]]:
    """Follow the trunk up to the joint from which two branches reach out to opposite sides; none if there is none."""
    points = rig.positions

    def visit(node: int) -> Iterator[int]:
        yield node
        for child in rig.children[node]:
            if child in widest:
                yield from visit(child)

    for chest in visit(trunk):
        branches = [child for child in rig.children[chest] if child in widest and rig.children[child]]
        reach = {child: points[widest[child]] - points[chest] for child in branches}
        branches.sort(key=lambda child: -float(np.hypot(*reach[child][[0, 2]])))
        if len(branches) >= 2 and reach[branches[0]][[0, 2]] @ reach[branches[1]][[0, 2]] < 0:
            return chest, branches[:2]
    return trunk, []


def _hand_limb(rig: Rig, path: Sequence[int]) -> tuple[int, int, int] | None:
    """Find upper arm, forearm and hand on the way to the outermost tip; the hand is where fingers branch off."""
    fingers = (index for index, node in enumerate(path) if index >= 2 and len(rig.children[node]) >= 3)
    hand = next(fingers, None)
    return _three(rig.positions, path if hand is None else path[: hand + 1], tip=hand is not None)


def _three(points: np.ndarray, path: Sequence[int], *, tip: bool) -> tuple[int, int, int] | None:
    """Choose the joints on a path with the longest and most even two bones; with `tip` the third is the path's end."""
    count = len(path)
    if not 3 <= count <= 24:
        return None
    ends = [count - 1] if tip else range(2, count)
    choices = [(i, j, k) for k in ends for j in range(1, k) for i in range(j)]

    def evenness(choice: tuple[int, int, int]) -> float:
        first, middle, last = (points[path[index]] for index in choice)
        upper, lower = np.linalg.norm(middle - first), np.linalg.norm(last - middle)
        return float(min(upper, lower) - abs(upper - lower) / 2)

    best = max(choices, key=evenness)
    return path[best[0]], path[best[1]], path[best[2]]
