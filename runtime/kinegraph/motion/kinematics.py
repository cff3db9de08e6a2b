"""Inverse and forward kinematics: joint positions to rotations of a rigid skeleton, and back.

The rest pose is a T-pose that faces +Z (Y up, metres) with the clip's own mean bone lengths. Rotations are solved from
the pelvis outwards:

- Pelvis and chest (spine3) have three children each. Their rotation fits all three in least squares (Kabsch, 1976, in
  the singular value form of Markley, 1988).
- A joint with one child is split into swing and twist (Dobrowolski, 2015). The swing is the shortest rotation that
  aims the bone at the child.
- Twist about the bone is not visible in the positions of its two ends. Upper arm and thigh take it from the plane in
  which elbow and knee bend, because these are hinges. The straighter the limb, the less that plane says: then the
  frames around count, and where those are straight too, the swing alone.
- The vertebrae between pelvis and chest share the twist between the two evenly.
- Joints without children are not rotated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import Floats
from kinegraph.motion.quaternions import (
    IDENTITY,
    about_axis,
    conjugate,
    continuous_signs,
    cross,
    from_matrix,
    multiply,
    normalised,
    rotate,
    shortest_rotation,
)
from kinegraph.motion.skeleton import (
    HORIZONTAL,
    JOINT_INDEX,
    JOINT_NAMES,
    JOINTS,
    PARENTS,
    PELVIS,
    bone_lengths,
    facing_angle,
)

CHILDREN: Final[tuple[tuple[int, ...], ...]] = tuple(
    tuple(child for child, parent in enumerate(PARENTS) if parent == joint) for joint in range(JOINTS)
)


def _by_depth() -> tuple[list[int], ...]:
    levels = [[PELVIS]]
    while below := [child for joint in levels[-1] for child in CHILDREN[joint]]:
        levels.append(below)
    return tuple(levels[1:])


BY_DEPTH: Final = _by_depth()
"""Joints below the pelvis that are as far from it as one another; parents before children."""

CHEST: Final = JOINT_INDEX["spine3"]
SPINE: Final = (JOINT_INDEX["spine1"], JOINT_INDEX["spine2"])
"""Joints between pelvis and chest; they share the twist with the chest."""

HINGES: Final[dict[int, tuple[int, int, tuple[float, float, float]]]] = {
    JOINT_INDEX[f"{side}_{upper}"]: (JOINT_INDEX[f"{side}_{middle}"], JOINT_INDEX[f"{side}_{end}"], axis)
    for upper, middle, end, axes in (
        ("shoulder", "elbow", "wrist", {"left": (0.0, -1.0, 0.0), "right": (0.0, 1.0, 0.0)}),
        ("hip", "knee", "ankle", {"left": (1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0)}),
    )
    for side, axis in axes.items()
}
"""Joint -> its hinge, the end of the limb, and the axis of the hinge in the T-pose.

Right-handed rotation about the axis bends forearms forward and shins backward.
"""

SOLVED_TOGETHER: Final[tuple[list[int], ...]] = tuple(
    [JOINT_INDEX[name] for name in names.split()]
    for names in (
        "spine1", "spine2", "spine3", "neck left_collar right_collar",
        "left_hip right_hip left_shoulder right_shoulder", "left_knee right_knee left_elbow right_elbow",
        "left_ankle right_ankle",
    )
)  # fmt: skip
"""Joints that turn, below the pelvis: of one kind, none below another of its group; parents before children."""

TRUSTED_BEND: Final = 0.35
"""Sine of the bend (20 degrees) from which its plane has the full weight of 1."""
UNTWISTED_WEIGHT: Final = 0.1
"""Weight of no twist, against that of the planes."""
TWIST_WINDOW_SECONDS: Final = 0.2
"""To each side: radius of the Gaussian over which planes are averaged."""

_LEFT_DIRECTIONS: Final[dict[str, tuple[float, float, float]]] = {
    "pelvis": (0.0, 0.0, 0.0),
    "hip": (0.9, -0.4, 0.0),
    "knee": (0.0, -1.0, 0.0),
    "ankle": (0.0, -1.0, 0.0),
    "foot": (0.0, -0.45, 0.89),
    "collar": (0.5, 0.8, 0.0),
    "shoulder": (1.0, 0.0, 0.0),
    "elbow": (1.0, 0.0, 0.0),
    "wrist": (1.0, 0.0, 0.0),
}
"""T-pose direction from the parent, left side; other joints (spine, neck, head) are straight above theirs."""


def _rest_direction(name: str) -> tuple[float, float, float]:
    """Look up a joint's T-pose direction; the right side is mirrored."""
    side, _, part = name.rpartition("_")
    x, y, z = _LEFT_DIRECTIONS.get(part, (0.0, 1.0, 0.0))
    return (-x if side == "right" else x, y, z)


REST_DIRECTIONS: Final[Floats] = normalised(np.array([_rest_direction(name) for name in JOINT_NAMES]))
"""(22, 3) unit vectors from the parent in the T-pose; `rest_offsets` fits those of the children of pelvis and chest."""

REST_OFFSETS: Final[Floats] = 0.01 * np.array(
    [
        (0, 0, 0), (6.2, -7.5, -4.5), (-6.2, -7.5, -4.5), (0, 13.2, 0), (0, -39.2, 0), (0, -39.2, 0), (0, 14.3, 0),
        (0, -42.9, 0), (0, -42.9, 0), (0, 5.7, 0), (0, -6.6, 13), (0, -6.6, 13), (0, 21.9, 0), (7.5, 11.8, 0),
        (-7.5, 11.8, 0), (0, 10.3, 0), (12.7, 0, 0), (-12.7, 0, 0), (26, 0, 0), (-26, 0, 0), (26.8, 0, 0),
        (-26.8, 0, 0),
    ]
)  # fmt: skip
"""(22, 3) metres from the parent in a T-pose: the body of the default bundle."""


@dataclass(frozen=True)
class SkeletonMotion:
    """A clip as a skeleton with rigid bones and joint rotations."""

    rest_offsets: Floats
    """(22, 3) metres: offset of each joint from its parent in the T-pose; zero for the pelvis."""

    root: Floats
    """(frames, 3) metres: position of the pelvis."""

    rotations: Floats
    """(frames, 22, 4) quaternions w, x, y, z relative to the parent; signs are continuous over frames."""

    error: Floats
    """(frames, 22) metres between `forward_kinematics` of this motion and the joints it was solved from."""


def rotations_from_positions(joints: Floats, fps: float, *, loops: bool = False) -> SkeletonMotion:
    """Solve the rotations that bring a T-pose with the clip's mean bone lengths to the joints of each frame.

    Args:
        joints: (frames, 22, 3) metres, Y up.
        fps: frames per second; sets the window over which limbs that are straight for a moment keep their twist.
        loops: treat the clip as periodic (last frame == first but for travel), so both ends get the same twist.

    Returns:
        The skeleton, its motion and the remaining error.
    """
    target = np.asarray(joints, dtype=np.float64)
    offsets = rest_offsets(target)
    local = np.tile(np.array(IDENTITY), (len(target), JOINTS, 1))
    world = local.copy()
    solved = np.zeros_like(target)
    root, twist_share = _root_and_twist(target, offsets)
    children = list(CHILDREN[PELVIS])
    solved[:, PELVIS] = root
    world[:, PELVIS] = local[:, PELVIS] = _best_rotation(offsets[children], target[:, children] - root[:, None])
    for group in SOLVED_TOGETHER:
        parents, children = [PARENTS[joint] for joint in group], [CHILDREN[joint][0] for joint in group]
        if group == [CHEST]:
            children = list(CHILDREN[CHEST])
        above, bones = world[:, parents], offsets[children]
        back = conjugate(above)
        solved[:, group] = solved[:, parents] + rotate(above, offsets[group])
        # aim from the solved position, not from the target's: errors do not add up along a limb
        goals = rotate(back, target[:, children] - solved[:, group])
        turns = _best_rotation(bones, goals)[:, None] if group == [CHEST] else shortest_rotation(bones, goals)
        if group[0] in HINGES:
            ends, axes = [HINGES[joint][1] for joint in group], np.array([HINGES[joint][2] for joint in group])
            lower = rotate(back, target[:, ends] - target[:, children])
            turns = apply_twist(turns, bones, hinge_twist(bones, goals, lower, axes, fps, loops=loops))
        elif group[0] in SPINE:
            turns = apply_twist(turns, bones, twist_share[:, None])
        local[:, group], world[:, group] = turns, multiply(above, turns)
    leaves = [joint for joint in range(JOINTS) if not CHILDREN[joint]]
    parents = [PARENTS[joint] for joint in leaves]
    solved[:, leaves] = solved[:, parents] + rotate(world[:, parents], offsets[leaves])
    error = np.linalg.norm(solved - target, axis=-1)
    return SkeletonMotion(offsets, root, continuous_signs(local), error)


def _root_and_twist(target: Floats, offsets: Floats) -> tuple[Floats, Floats]:
    """Compute the position (frames, 3) of the pelvis, and the twist (frames,) of each joint of the spine."""
    forks, children = [PELVIS, CHEST], np.array([CHILDREN[PELVIS], CHILDREN[CHEST]])
    goals = (target[:, children] - target[:, forks, None]).swapaxes(0, 1)
    pelvis, chest = _best_rotation(offsets[children][:, None], goals)
    # a generated pelvis is not quite rigid: pelvis and its children share the error that its rotation leaves
    missed = goals[0] - rotate(pelvis[:, None], offsets[children[0]])
    root = target[:, 0] + missed.sum(axis=1) / (1 + len(children[0]))
    return root, spine_twist(pelvis, chest) / (1 + len(SPINE))


@dataclass(frozen=True)
class RootMotion:
    """A motion whose pelvis hangs on a root joint; the root is on the floor, carries travel and heading."""

    root: Floats
    """(frames, 3) metres: the point of the floor below the pelvis."""

    root_rotations: Floats
    """(frames, 4) quaternions w, x, y, z about +Y: the heading (`skeleton.facing_angle`)."""

    pelvis: Floats
    """(frames, 3) metres: position of the pelvis relative to the root."""

    pelvis_rotations: Floats
    """(frames, 4) quaternions relative to the root; signs are continuous over frames."""


def split_root(motion: SkeletonMotion, joints: Floats) -> RootMotion:
    """Split the motion of the pelvis into that of a root joint on the floor and the rest.

    Root motion in engines: a character moves with the root, and the animation plays relative to it. Travel and heading
    are those of the clip, not of its solution, so the root of a clip in place does not move at all.

    Args:
        motion: solution of the clip.
        joints: (frames, 22, 3) metres, the clip.
    """
    root = np.asarray(joints[:, PELVIS], dtype=np.float64) * HORIZONTAL
    turned = about_axis(1, facing_angle(joints).astype(np.float64))
    back = conjugate(turned)
    pelvis = rotate(back, motion.root - root)
    return RootMotion(root, turned, pelvis, continuous_signs(multiply(back, motion.rotations[:, PELVIS])))


def join_root(split: RootMotion) -> tuple[Floats, Floats]:
    """Undo `split_root`: positions (frames, 3) metres and rotations (frames, 4) of the pelvis in the world."""
    pelvis = split.root + rotate(split.root_rotations, split.pelvis)
    return pelvis, multiply(split.root_rotations, split.pelvis_rotations)


def rest_pose(offsets: Floats) -> Floats:
    """Place the joints of the T-pose: feet on the floor, pelvis above the origin.

    Args:
        offsets: (22, 3) metres, each joint from its parent at rest.

    Returns:
        (22, 3) metres; the lowest joint is at y = 0.
    """
    joints = np.zeros((JOINTS, 3))
    for joint in range(1, JOINTS):
        joints[joint] = joints[PARENTS[joint]] + offsets[joint]
    joints[:, 1] -= joints[:, 1].min()
    return joints


def forward_kinematics(offsets: Floats, root: Floats, rotations: Floats) -> Floats:
    """Compute joint positions from rotations.

    Args:
        offsets: (22, 3) metres, each joint from its parent at rest.
        root: (frames, 3) metres.
        rotations: (frames, 22, 4) quaternions relative to the parent.

    Returns:
        (frames, 22, 3) metres.
    """
    joints = np.zeros((len(rotations), JOINTS, 3))
    world = np.array(rotations, dtype=np.float64)
    joints[:, 0] = root
    for level in BY_DEPTH:
        parents = [PARENTS[joint] for joint in level]
        joints[:, level] = joints[:, parents] + rotate(world[:, parents], offsets[level])
        world[:, level] = multiply(world[:, parents], world[:, level])
    return joints


def rest_offsets(joints: Floats) -> Floats:
    """Fit the T-pose of a clip: mean bone lengths, children of pelvis and chest in their mean arrangement.

    Args:
        joints: (frames, 22, 3) metres, Y up.

    Returns:
        (22, 3) metres, offset of each joint from its parent.
    """
    lengths = np.concatenate([[0.0], bone_lengths(np.asarray(joints)).mean(axis=0, dtype=np.float64)])
    directions = REST_DIRECTIONS.copy()
    for joint, up in ((PELVIS, "spine1"), (CHEST, "neck")):
        children = list(CHILDREN[joint])
        left, right = (child for child in children if child != JOINT_INDEX[up])
        bones = np.asarray(joints[:, children] - joints[:, joint, None], dtype=np.float64)
        axes = _body_axes(joints[:, left] - joints[:, right], joints[:, JOINT_INDEX[up]] - joints[:, joint])
        mean = normalised(np.einsum("tij,tcj->tci", axes, bones).mean(axis=0))
        no_length = ~mean.any(axis=-1)
        mean[no_length] = REST_DIRECTIONS[children][no_length]
        directions[children] = mean
    return np.asarray(directions * lengths[:, None])


def hinge_twist(rest: Floats, goal: Floats, lower: Floats, axis: Floats, fps: float, *, loops: bool = False) -> Floats:
    """Compute the twist about upper bones that rotates the rest hinge axis onto the one observed.

    Args:
        rest: (..., 3) the upper bones at rest.
        goal: (frames, ..., 3) the upper bones, in the frame of their parents.
        lower: (frames, ..., 3) the lower bones, in the same frame.
        axis: (..., 3) of the hinges at rest.
        fps: frames per second.
        loops: treat the clip as periodic (last frame == first), so smoothing wraps around.

    Returns:
        (frames, ...) radians.
    """
    bone = normalised(goal)
    # observed hinge axis: normal of the bend plane, as long as the sine of the bend
    normal = cross(bone, normalised(lower))
    swung = rotate(shortest_rotation(rest, goal), np.asarray(axis, dtype=np.float64))
    # angle about the bone from the swung rest axis to the observed one
    sine = (cross(swung, normal) * bone).sum(-1)
    cosine = (swung * normal).sum(-1)
    size = np.hypot(sine, cosine)
    weight = np.minimum(size / TRUSTED_BEND, 1.0) ** 2
    # weighted circular mean: angles as unit complex numbers, together with the angle 0 at its own weight
    angles = weight * (cosine + 1j * sine) / np.where(size > 0, size, 1.0)
    return np.asarray(
        np.angle(_windowed_mean(angles, max(1, round(TWIST_WINDOW_SECONDS * fps)), loops) + UNTWISTED_WEIGHT)
    )


def spine_twist(pelvis: Floats, chest: Floats) -> Floats:
    """Compute the twist of the chest against the pelvis about the spine (+Y), positive to the left.

    Args:
        pelvis, chest: (frames, 4) rotations from rest, in the world.

    Returns:
        (frames,) radians.
    """
    relative = multiply(conjugate(pelvis), chest)
    # twist about Y of the swing-twist decomposition: 2 atan2(y, w); q and -q are the same rotation
    return np.asarray(2 * np.arctan2(relative[:, 2] * np.sign(relative[:, 0]), np.abs(relative[:, 0])))


def apply_twist(swing: Floats, rest: Floats, angle: Floats) -> Floats:
    """Compose swing and twist: rotate about the resting bone first, then swing it.

    Args:
        swing: (frames, ..., 4) quaternions.
        rest: (..., 3) the bones at rest.
        angle: (frames, ...) radians of twist.

    Returns:
        (frames, ..., 4).
    """
    half = np.asarray(angle)[..., None] / 2
    twist = np.concatenate([np.cos(half), np.sin(half) * normalised(np.asarray(rest, dtype=np.float64))], axis=-1)
    return multiply(swing, twist)


def _body_axes(across: Floats, up: Floats) -> Floats:
    """Build the axes (frames, 3, 3) of a body part: rows x (to the left), y (up the spine), z (ahead)."""
    x = normalised(np.asarray(across, dtype=np.float64))
    z = normalised(cross(x, up))
    return np.stack([x, cross(z, x), z], axis=-2)


def _best_rotation(rest: Floats, goals: Floats) -> Floats:
    """Fit the rotations (..., 4) that take `rest` (..., n, 3) to `goals` (..., n, 3) in least squares."""
    u, _, vt = np.linalg.svd(goals.swapaxes(-1, -2) @ rest)
    # R = U diag(1, 1, det(U V^T)) V^T: a rotation, not a reflection
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return from_matrix(u @ vt)


def _windowed_mean(
    values: NDArray[np.complexfloating[Any, Any]], radius: int, loops: bool
) -> NDArray[np.complexfloating[Any, Any]]:
    """Average (frames, ...) over `radius` frames to each side with Gaussian weights.

    Frames beyond the ends are left out; with `loops` they are those of the rounds before and after.
    """
    loops = loops and len(values) > 1
    gaussian = np.exp(-0.5 * (np.arange(-radius, radius + 1) / (radius / 2)) ** 2)
    if loops:
        padded = np.pad(values[:-1], [(radius, radius + 1), *[(0, 0)] * (values.ndim - 1)], mode="wrap")
    else:
        beyond = np.zeros((radius, *values.shape[1:]))
        padded = np.concatenate([beyond, values, beyond])
    counts = np.pad(np.ones(len(values)), radius, constant_values=float(loops))
    windows = np.lib.stride_tricks.sliding_window_view
    share = (windows(counts, len(gaussian)) @ gaussian).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((windows(padded, len(gaussian), axis=0) @ gaussian) / share)
