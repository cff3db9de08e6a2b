"""Joint positions -> rotations of a skeleton with fixed bones, and back.

The rest pose is a T-pose that faces +Z, with the clip's own bone lengths. The pelvis and the upper spine
(spine3) have three children each, and their turn is the one that brings all three closest to where they were
seen (Kabsch, 1976; Markley's (1988) singular value form). A joint with one child takes the shortest turn
from its parent that aims at the child, after the turn about its own length that `twist` finds for shoulders, hips and
spine; joints without one are not turned.

How limbs and spine are twisted about their own length, which positions of joints do not show directly.

Arms and legs: an elbow and a knee are hinges, so the plane in which they bend tells how the upper arm and the thigh are
turned. The straighter the limb, the less its plane says; there the turn is taken from the frames around, and from the
shortest turn where those are straight, too. Spine: what chest and pelvis are turned against each other is shared out
evenly between them, as vertebrae do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import Floats
from kinegraph.motion.quaternions import (
    IDENTITY,
    between,
    conjugate,
    continuous,
    from_matrix,
    multiply,
    normalised,
    rotate,
)
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, JOINTS, PARENTS, bone_lengths

CHILDREN: Final[tuple[tuple[int, ...], ...]] = tuple(
    tuple(child for child, parent in enumerate(PARENTS) if parent == joint) for joint in range(JOINTS)
)

CHEST: Final = JOINT_INDEX["spine3"]
SPINE: Final = (JOINT_INDEX["spine1"], JOINT_INDEX["spine2"])
"""Joints between pelvis and chest, which share their twist with the chest."""

_FOOT: Final = (0.0, -0.45, 0.89)
_PART_DIRECTIONS: Final[dict[str, tuple[float, float, float]]] = {
    "pelvis": (0.0, 0.0, 0.0),
    "hip": (0.9, -0.4, 0.0),
    "knee": (0.0, -1.0, 0.0),
    "ankle": (0.0, -1.0, 0.0),
    "foot": _FOOT,
    "collar": (0.5, 0.8, 0.0),
    "shoulder": (1.0, 0.0, 0.0),
    "elbow": (1.0, 0.0, 0.0),
    "wrist": (1.0, 0.0, 0.0),
}
"""T-pose direction from the parent, left side; other joints (spine, neck, head) are straight above theirs."""


def _rest_direction(name: str) -> tuple[float, float, float]:
    side, _, part = name.rpartition("_")
    x, y, z = _PART_DIRECTIONS.get(part, (0.0, 1.0, 0.0))
    return (-x if side == "right" else x, y, z)


REST_DIRECTIONS: Final[Floats] = normalised(np.array([_rest_direction(name) for name in JOINT_NAMES]))
"""(22, 3) unit vectors from the parent in the T-pose; a clip replaces those of siblings by what it shows."""


@dataclass(frozen=True)
class SkeletonMotion:
    """A clip as a skeleton with fixed bones that turn."""

    rest_offsets: Floats
    """(22, 3) metres: each joint from its parent in the T-pose; the pelvis's is zero."""

    root: Floats
    """(frames, 3) metres: where the pelvis is."""

    rotations: Floats
    """(frames, 22, 4) quaternions w, x, y, z relative to the parent; signs are continuous over frames."""

    error: Floats
    """(frames, 22) metres between `forward_kinematics` of this motion and the joints it was solved from."""


def rotations_from_positions(joints: Floats, fps: float, *, loops: bool = False) -> SkeletonMotion:
    """Rotations that bring a T-pose with the clip's mean bone lengths to the joints of each frame.

    Args:
        joints: (frames, 22, 3) metres, Y up.
        fps: frames per second; limbs that are straight for a moment keep the twist that they have beside it.
        loops: whether the last frame is the first again, but for travel; then it is turned as the first is.
    """
    seen = np.asarray(joints, dtype=np.float64)
    offsets = rest_offsets(seen)
    local = np.tile(np.array(IDENTITY), (len(seen), JOINTS, 1))
    turned = local.copy()
    reached = np.zeros_like(seen)
    chest, trunk = list(CHILDREN[CHEST]), list(CHILDREN[0])
    pelvis = _best_turn(offsets[trunk], seen[:, trunk] - seen[:, :1])
    share = spine_twist(pelvis, _best_turn(offsets[chest], seen[:, chest] - seen[:, CHEST, None])) / (1 + len(SPINE))
    # A pelvis is stiff and a generated one is not quite: what its turn cannot reach is shared by all of its joints.
    missed = seen[:, trunk] - seen[:, :1] - rotate(pelvis[:, None], offsets[trunk])
    root = seen[:, 0] + missed.sum(axis=1) / (1 + len(trunk))
    for joint in range(JOINTS):
        parent = PARENTS[joint]
        before = turned[:, parent] if joint else turned[:, joint]
        reached[:, joint] = root if not joint else reached[:, parent] + rotate(before, offsets[joint])
        children = list(CHILDREN[joint])
        # Aimed from where the bones so far have led, not from where the joint was seen: errors do not add up.
        goals = rotate(conjugate(before)[:, None], seen[:, children] - reached[:, joint, None])
        if len(children) > 1:
            local[:, joint] = _best_turn(offsets[children], goals)
        elif children:
            local[:, joint] = between(offsets[children[0]], goals[:, 0])
            if joint in HINGES:
                middle, end, axis = HINGES[joint]
                lower = rotate(conjugate(before), seen[:, end] - seen[:, middle])
                angle = hinge_twist(offsets[middle], goals[:, 0], lower, np.array(axis), fps, loops=loops)
                local[:, joint] = twisted(local[:, joint], offsets[middle], angle)
            elif joint in SPINE:
                local[:, joint] = twisted(local[:, joint], offsets[children[0]], share)
        turned[:, joint] = multiply(before, local[:, joint])
    error = np.linalg.norm(reached - seen, axis=-1)
    return SkeletonMotion(offsets, root, continuous(local), error)


def forward_kinematics(offsets: Floats, root: Floats, rotations: Floats) -> Floats:
    """Joints (frames, 22, 3) metres of a skeleton that turns.

    Args:
        offsets: (22, 3) metres, each joint from its parent at rest.
        root: (frames, 3) metres.
        rotations: (frames, 22, 4), relative to the parent.
    """
    joints = np.zeros((len(rotations), JOINTS, 3))
    turned = np.array(rotations, dtype=np.float64)
    joints[:, 0] = root
    for joint in range(1, JOINTS):
        parent = PARENTS[joint]
        joints[:, joint] = joints[:, parent] + rotate(turned[:, parent], offsets[joint])
        turned[:, joint] = multiply(turned[:, parent], turned[:, joint])
    return joints


def rest_offsets(joints: Floats) -> Floats:
    """T-pose offsets (22, 3) of a clip: mean bone lengths, siblings as they lie to each other on average."""
    lengths = np.concatenate([[0.0], bone_lengths(np.asarray(joints)).mean(axis=0, dtype=np.float64)])
    directions = REST_DIRECTIONS.copy()
    for joint, up in ((JOINT_INDEX["pelvis"], "spine1"), (JOINT_INDEX["spine3"], "neck")):
        children = list(CHILDREN[joint])
        left, right = (child for child in children if child != JOINT_INDEX[up])
        bones = np.asarray(joints[:, children] - joints[:, joint, None], dtype=np.float64)
        frame = _plane_frame(joints[:, left] - joints[:, right], joints[:, JOINT_INDEX[up]] - joints[:, joint])
        seen = normalised(np.einsum("tij,tcj->tci", frame, bones).mean(axis=0))
        missing = ~seen.any(axis=-1)
        seen[missing] = REST_DIRECTIONS[children][missing]
        directions[children] = seen
    return np.asarray(directions * lengths[:, None])


def _plane_frame(across: Floats, up: Floats) -> Floats:
    """Axes (frames, 3, 3) of a body part: rows x (to the left), y (up the spine), z (ahead)."""
    x = normalised(np.asarray(across, dtype=np.float64))
    z = normalised(np.cross(x, up, axis=-1))
    return np.stack([x, np.cross(z, x, axis=-1), z], axis=-2)


def _best_turn(rest: Floats, goals: Floats) -> Floats:
    """The turn (frames, 4) that takes `rest` (n, 3) closest to `goals` (frames, n, 3) in least squares."""
    u, _, vt = np.linalg.svd(np.einsum("tci,cj->tij", goals, rest))
    # Of the two solutions of a flat triple, the one that is a turn and no mirror image.
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return from_matrix(u @ vt)


HINGES: Final[dict[int, tuple[int, int, tuple[float, float, float]]]] = {
    JOINT_INDEX[f"{side}_{upper}"]: (JOINT_INDEX[f"{side}_{middle}"], JOINT_INDEX[f"{side}_{end}"], axis)
    for upper, middle, end, axes in (
        ("shoulder", "elbow", "wrist", {"left": (0.0, -1.0, 0.0), "right": (0.0, 1.0, 0.0)}),
        ("hip", "knee", "ankle", {"left": (1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0)}),
    )
    for side, axis in axes.items()
}
"""Joint -> its hinge, the end of the limb, and the axis about which the hinge bends in the T-pose: forearms forward,
shins backward, right-handed."""

BENT: Final = 0.35
"""Sine of a bend from which its plane is believed fully (20 degrees)."""
STRAIGHT: Final = 0.1
"""How much the shortest turn counts beside planes, whose weights are up to 1."""
WINDOW_SECONDS: Final = 0.2
"""To each side: frames that have a say, in a bell curve."""


def hinge_twist(rest: Floats, goal: Floats, lower: Floats, axis: Floats, fps: float, *, loops: bool = False) -> Floats:
    """Turns (frames,) in radians about the upper bone that bring the rest hinge into the plane that is seen.

    Args:
        rest: (3,) the upper bone at rest.
        goal: (frames, 3) the upper bone, in the frame of its parent.
        lower: (frames, 3) the lower bone, in the same frame.
        axis: (3,) of the hinge at rest.
        fps: frames per second.
        loops: whether the last frame is the first again, so that what is beside one is beside the other.
    """
    along, across = normalised(goal), np.cross(normalised(goal), normalised(lower), axis=-1)
    swung = rotate(between(rest, goal), np.asarray(axis, dtype=np.float64))
    # angle from the swung axis to the seen one about the bone; the length of `across` is the sine of the bend
    sine = (np.cross(swung, across, axis=-1) * along).sum(-1)
    cosine = (swung * across).sum(-1)
    size = np.hypot(sine, cosine)
    believed = np.minimum(size / BENT, 1.0) ** 2
    seen = believed * (cosine + 1j * sine) / np.where(size > 0, size, 1.0)
    return np.asarray(np.angle(_smoothed(seen, max(1, round(WINDOW_SECONDS * fps)), loops) + STRAIGHT))


def spine_twist(pelvis: Floats, chest: Floats) -> Floats:
    """How far (frames,) in radians the chest is turned against the pelvis about the spine, to the left positive.

    Args:
        pelvis, chest: (frames, 4) turns from rest, in the world.
    """
    relative = multiply(conjugate(pelvis), chest)
    # the turn about Y of a swing-twist decomposition; q and -q are the same turn
    return np.asarray(2 * np.arctan2(relative[:, 2] * np.sign(relative[:, 0]), np.abs(relative[:, 0])))


def twisted(swing: Floats, rest: Floats, angle: Floats) -> Floats:
    """A swing (frames, 4) after a turn by `angle` (frames,) about the resting bone `rest` (3,)."""
    half = np.asarray(angle)[:, None] / 2
    turn = np.concatenate([np.cos(half), np.sin(half) * normalised(np.asarray(rest, dtype=np.float64))], axis=-1)
    return multiply(swing, turn)


def _smoothed(
    values: NDArray[np.complexfloating[Any, Any]], window: int, loops: bool
) -> NDArray[np.complexfloating[Any, Any]]:
    """A mean over `window` frames to each side in a bell curve; frames beyond the ends are left out, or those of the
    round before and after."""
    bell = np.exp(-0.5 * (np.arange(-window, window + 1) / (window / 2)) ** 2)
    padded = np.pad(values[:-1], (window, window + 1), mode="wrap") if loops else np.pad(values, window)
    counts = np.pad(np.ones(len(values)), window, constant_values=float(loops))
    windows = np.lib.stride_tricks.sliding_window_view
    return np.asarray((windows(padded, len(bell)) @ bell) / (windows(counts, len(bell)) @ bell))
