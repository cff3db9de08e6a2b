"""Energies of a motion: how far its joints are from what is wanted, with gradients, as pure functions of arrays.

EnergyMoGen composes motions by adding energies E(z) of a latent z (Eq. 6-8). Each function here is one more term of
that sum, of the joints that z decodes to: it returns the energy and dE/djoints, which `features.joints_vjp` and the
decoder's vector-Jacobian product carry back to z.

    position_energy     joints at places: root paths, hands, feet, poses in the world
    heading_energy      where the body faces
    pose_energy         poses up to place on the floor and heading, with the velocity between frames
    relative_energy     parts of the body relative to the pelvis
    loop_energy         the last frame as the first, with its velocity
    floor_energy        feet not under the floor
    stance_energy       planted feet that do not slide

All are half sums of weighted squares of metres, but for the heading, so that weights are comparable. Joints are
(frames, 22, 3) metres with Y up; gradients have the same shape.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, Floats
from kinegraph.motion.skeleton import (
    FEET,
    HORIZONTAL,
    JOINT_INDEX,
    LEFT_HIP,
    LEFT_SHOULDER,
    PELVIS,
    RIGHT_HIP,
    RIGHT_SHOULDER,
)

Energy = tuple[float, DoubleArray]
"""Energy, and its gradient with respect to the joints (frames, 22, 3)."""

TOES: Final = (JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"])
_ACROSS: Final = ((RIGHT_HIP, 1.0), (LEFT_HIP, -1.0), (RIGHT_SHOULDER, 1.0), (LEFT_SHOULDER, -1.0))
"""Joints whose sum, with these signs, points to the right of the body (`skeleton.facing_angle`)."""


def position_energy(joints: Floats, target: Floats, weight: Floats) -> Energy:
    """Compute 1/2 sum w (x - target)^2: root trajectories, joints and poses at moments.

    The squared distance to a target is the energy of GMD (Karunratanakul et al., 2023, Eq. 6) and of OmniControl (Xie
    et al., 2024, Eq. 5).

    Args:
        joints: (frames, 22, 3) metres.
        target: (frames, 22, 3) metres; anything where the weight is 0.
        weight: (frames, 22, 3), 0 where an axis is free.
    """
    difference = joints - target
    gradient = weight * difference
    return 0.5 * float((gradient * difference).sum()), gradient


def heading_energy(joints: Floats, angle: Floats, weight: Floats) -> Energy:
    """Compute sum w (1 - cos(heading - angle)), which is 1/2 w (heading - angle)^2 for small differences.

    The heading is that of `skeleton.facing_angle`: atan2(a_z, -a_x) with the horizontal vector a across the body.

    Args:
        joints: (frames, 22, 3) metres.
        angle: (frames,) radians wanted.
        weight: (frames,), m^2 for a radian.
    """
    heading, slope = _heading_and_slope(joints)
    difference = heading - angle
    gradient = np.zeros(joints.shape)
    _add_heading_gradient(gradient, weight * np.sin(difference), slope)
    return float((weight * (1.0 - np.cos(difference))).sum()), gradient


def pose_energy(joints: Floats, pose: Floats, first: int, anchor: int, weight: Floats, steps: Floats) -> Energy:
    """Compute the energy of poses wherever on the floor they are, and of the velocity between their frames.

    1/2 sum w |L(x) - p|^2 + 1/2 sum v |D L(x) - D p|^2, D the difference from frame to frame. L moves the
    pelvis of the anchor frame to the origin of the floor and turns the body so that it faces +Z there, as HumanML3D
    places poses (Guo et al., 2022).

    Args:
        joints: (frames, 22, 3) metres, of the whole clip.
        pose: p, (n, 22, 3) metres, its anchor frame above the origin and facing +Z.
        first: of the n frames of the clip that shall be in these poses.
        anchor: frame of the clip that is moved to the origin.
        weight: w, (n,).
        steps: v, (n - 1,), from each frame to the next.
    """
    local, back = _to_local(joints, slice(first, first + len(pose)), anchor)
    difference, weights = local - pose, weight[:, None, None]
    change = np.diff(difference, axis=0)
    cotangent = weights * difference
    pull = steps[:, None, None] * change
    cotangent[1:] += pull
    cotangent[:-1] -= pull
    energy = 0.5 * float((weights * difference**2).sum() + (pull * change).sum())
    return energy, back(cotangent)


def relative_energy(joints: Floats, local: Floats, weight: Floats) -> Energy:
    """Compute 1/2 sum w |L_t(x_t) - local|^2: parts of the body relative to the pelvis and heading of each frame.

    Args:
        joints: (frames, 22, 3) metres.
        local: (frames, 22, 3) metres, see `to_own_frames`.
        weight: (frames, 22).
    """
    own, back = to_own_frames(joints)
    difference = own - local
    cotangent = weight[..., None] * difference
    return 0.5 * float((cotangent * difference).sum()), back(cotangent)


def to_own_frames(joints: Floats) -> tuple[DoubleArray, Callable[[Floats], DoubleArray]]:
    """Move and turn every frame so that its pelvis is above the origin and its body faces +Z.

    Returns:
        (frames, 22, 3) metres, and the function that carries a cotangent of them back to the joints.
    """
    heading, slope = _heading_and_slope(joints)
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    moved = joints - joints[:, :1] * HORIZONTAL
    local = np.stack(
        [cos * moved[..., 0] - sin * moved[..., 2], moved[..., 1], sin * moved[..., 0] + cos * moved[..., 2]], axis=-1
    )

    def back(cotangent: Floats) -> DoubleArray:
        x, z = cotangent[..., 0], cotangent[..., 2]
        gradient = np.stack([cos * x + sin * z, cotangent[..., 1], cos * z - sin * x], axis=-1)
        gradient[:, PELVIS] -= gradient.sum(axis=1) * HORIZONTAL
        _add_heading_gradient(gradient, (z * local[..., 0] - x * local[..., 2]).sum(axis=1), slope)
        return gradient

    return local, back


def loop_energy(joints: Floats, weight: float, velocity: float) -> Energy:
    """Compute the energy of a clip that ends as it begins: the last pose is the first, and so are the steps beside it.

    The poses of the last frame and of the first are compared up to place and heading (`pose_energy`), and the step into
    the last frame with the step out of the first.

    Args:
        joints: (frames, 22, 3) metres.
        weight: of the poses.
        velocity: of the steps, relative to that of the poses.
    """
    last = len(joints) - 1
    begin, begin_back = _to_local(joints, slice(0, 2), 0)
    end, end_back = _to_local(joints, slice(last - 1, last + 1), last)
    pose = weight * (end[1] - begin[0])
    step = velocity * weight * ((end[1] - end[0]) - (begin[1] - begin[0]))
    gradient = end_back(np.stack([-step, pose + step])) + begin_back(np.stack([step - pose, -step]))
    squares = (pose * (end[1] - begin[0])).sum() + (step * ((end[1] - end[0]) - (begin[1] - begin[0]))).sum()
    return 0.5 * float(squares), gradient


def floor_energy(joints: Floats, weight: float) -> Energy:
    """Compute weight / 2 sum min(y, 0)^2 over ankles and toes: what is under the floor."""
    gradient = np.zeros(joints.shape)
    below = np.minimum(joints[:, list(FEET), 1], 0.0)
    gradient[:, list(FEET), 1] = weight * below
    return 0.5 * weight * float((below**2).sum()), gradient


def stance_energy(joints: Floats, planted: Floats) -> Energy:
    """Compute 1/2 sum w |step of a toe over the floor|^2: planted feet stand.

    The foot contact loss of MDM (Tevet et al., 2023, Eq. 4), for toes.

    Args:
        joints: (frames, 22, 3) metres.
        planted: (frames - 1, 2) weights w of left and right toe between each frame and the next.
    """
    toes = joints[:, list(TOES)][..., [0, 2]]
    steps = np.diff(toes, axis=0)
    pull = planted[..., None] * steps
    cotangent = np.zeros(toes.shape)
    cotangent[1:] += pull
    cotangent[:-1] -= pull
    gradient = np.zeros(joints.shape)
    for index, toe in enumerate(TOES):
        gradient[:, toe, 0], gradient[:, toe, 2] = cotangent[:, index, 0], cotangent[:, index, 1]
    return 0.5 * float((pull * steps).sum()), gradient


def _to_local(joints: Floats, frames: slice, anchor: int) -> tuple[DoubleArray, Callable[[Floats], DoubleArray]]:
    """Move and turn frames so that the anchor frame's pelvis is above the origin and its body faces +Z.

    Returns:
        (n, 22, 3) metres, and the function that carries a cotangent of them back to the joints of the clip.
    """
    heading, slope = _heading_and_slope(joints[anchor : anchor + 1])
    cos, sin = np.cos(heading[0]), np.sin(heading[0])
    moved = joints[frames] - joints[anchor, PELVIS] * HORIZONTAL
    local = np.stack(
        [cos * moved[..., 0] - sin * moved[..., 2], moved[..., 1], sin * moved[..., 0] + cos * moved[..., 2]], axis=-1
    )

    def back(cotangent: Floats) -> DoubleArray:
        x, z = cotangent[..., 0], cotangent[..., 2]
        turned = np.stack([cos * x + sin * z, cotangent[..., 1], cos * z - sin * x], axis=-1)
        gradient = np.zeros(joints.shape)
        gradient[frames] = turned
        gradient[anchor, PELVIS] -= turned.sum(axis=(0, 1)) * HORIZONTAL
        # d local / d heading = (-z, 0, x) of the local position
        of_heading = (z * local[..., 0] - x * local[..., 2]).sum()
        _add_heading_gradient(gradient[anchor : anchor + 1], np.array([of_heading]), slope)
        return gradient

    return local, back


def _heading_and_slope(joints: Floats) -> tuple[DoubleArray, DoubleArray]:
    """Compute headings (frames,) and their derivatives (frames, 2) by x and z of the vector a across the body.

    d atan2(a_z, -a_x) = (a_z d a_x - a_x d a_z) / |a|^2.
    """
    across = np.sum([sign * joints[:, joint][:, [0, 2]] for joint, sign in _ACROSS], axis=0)
    x, z = across[:, 0], across[:, 1]
    slope = np.stack([z, -x], axis=-1) / np.maximum(x**2 + z**2, 1e-6)[:, None]
    return np.arctan2(z, -x), slope


def _add_heading_gradient(gradient: DoubleArray, of_heading: Floats, slope: Floats) -> None:
    """Add dE/dheading (frames,), carried to the joints that the heading is measured by."""
    for joint, sign in _ACROSS:
        gradient[:, joint, 0] += sign * of_heading * slope[:, 0]
        gradient[:, joint, 2] += sign * of_heading * slope[:, 1]
