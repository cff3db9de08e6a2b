"""Pose limbs of captured bodies: arms and legs by inverse kinematics of two bones, the trunk by turning it.

All positions are metres, (frames, joints, 3), right-handed with Y up. Every bone keeps its length.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES
from kinegraph_training.data.common_skeleton import trunk_frames

REACH: Final = 0.985
"""Largest distance of shoulder and wrist as a share of the straight arm."""
TRUNK: Final = tuple(
    JOINT_INDEX[name]
    for name in JOINT_NAMES
    if name.endswith(("neck", "head", "collar", "shoulder", "elbow", "wrist")) or name.startswith("spine")
)
"""Joints above the pelvis, parents first."""


def smoothstep(t: DoubleArray) -> DoubleArray:
    """Ease in and out: 3 t^2 - 2 t^3."""
    return t * t * (3.0 - 2.0 * t)


def pose_arm(body: FloatArray, side: str, place: DoubleArray, pole: DoubleArray, weight: DoubleArray) -> FloatArray:
    """Move one wrist along a path by two-bone inverse kinematics.

    Args:
        body: (frames, 22, 3).
        side: "left" or "right".
        place: (frames, 3) of the wrist from the shoulder, in the chest's frame of the left arm: outwards, up, forward.
        pole: (3,) direction of the elbow in the same frame.
        weight: (frames,) 0 leaves the arm as it is, 1 puts the wrist in its place.
    """
    shoulder, elbow, wrist = (JOINT_INDEX[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist"))
    _, chest = trunk_frames(body)
    outwards = np.array([1.0 if side == "left" else -1.0, 1.0, 1.0])
    origin = body[:, shoulder].astype(np.float64)
    upper, fore = (np.linalg.norm(body[:, a] - body[:, b], axis=-1) for a, b in ((elbow, shoulder), (wrist, elbow)))
    share = weight[:, None]
    # The wrist goes around the shoulder, not through the body: direction and distance are blended apart.
    own, target = body[:, wrist] - origin, np.einsum("tij,tj->ti", chest, place * outwards)
    distance = (1 - weight) * np.linalg.norm(own, axis=-1) + weight * np.linalg.norm(target, axis=-1)
    distance = np.clip(distance, np.abs(upper - fore) + 0.03, REACH * (upper + fore))
    direction = unit(slerp(unit(own), unit(target), weight))
    bend = (1 - share) * unit(body[:, elbow] - origin) + share * unit(chest @ (pole * outwards))
    bend = unit(bend - (bend * direction).sum(-1, keepdims=True) * direction)
    middle, end = two_bones(origin, distance[:, None] * direction, bend, upper, fore)
    out = body.copy()
    moved = (weight > 0)[:, None]
    out[:, elbow] = np.where(moved, middle, body[:, elbow])
    out[:, wrist] = np.where(moved, end, body[:, wrist])
    return out


def two_bones(
    origin: DoubleArray, reach: DoubleArray, bend: DoubleArray, upper: DoubleArray, lower: DoubleArray
) -> tuple[DoubleArray, DoubleArray]:
    """Place the middle and the end of a chain of two bones by the law of cosines.

    Args:
        origin: (frames, 3) of the chain.
        reach: (frames, 3) from the origin to the end; no longer than both bones.
        bend: (frames, 3) unit vector at a right angle to `reach`: where the middle goes.
        upper: (frames,) length of the first bone.
        lower: (frames,) length of the second.
    """
    distance = np.linalg.norm(reach, axis=-1).clip(min=1e-9)
    # how far along the line to the end the middle stands, and how far beside it
    along = (upper**2 - lower**2 + distance**2) / (2 * distance)
    beside = np.sqrt(np.clip(upper**2 - along**2, 0.0, None))
    return origin + (along / distance)[:, None] * reach + beside[:, None] * bend, origin + reach


def shift_hips(body: DoubleArray, shift: DoubleArray, knees: DoubleArray | None = None) -> DoubleArray:
    """Move everything but the legs by `shift` (frames, 3), and bend the knees so that ankles and feet stay.

    Where a leg would be too short, all goes down as far as it must.

    Args:
        body: (frames, 22, 3).
        shift: (frames, 3).
        knees: (frames, 3) added to the direction in which each knee bends already; hips that go far need it.
    """
    legs = [[JOINT_INDEX[f"{side}_{name}"] for name in ("hip", "knee", "ankle")] for side in ("left", "right")]
    drop = np.zeros(len(body))
    for hip, _, ankle in legs:
        span, moved = body[:, hip] - body[:, ankle], body[:, hip] + shift - body[:, ankle]
        room = (span**2).sum(-1) - (moved[:, [0, 2]] ** 2).sum(-1)
        drop = np.maximum(drop, moved[:, 1] - np.sqrt(room.clip(min=0.0)))
    shift = shift - drop[:, None] * [0.0, 1.0, 0.0]
    out = body.copy()
    feet = [JOINT_INDEX[f"{side}_foot"] for side in ("left", "right")]
    upper = [joint for joint in range(body.shape[1]) if joint not in (*feet, *(j for leg in legs for j in leg[1:]))]
    out[:, upper] += shift[:, None]
    for hip, knee, ankle in legs:
        reach = body[:, ankle] - out[:, hip]
        bones = (np.linalg.norm(body[:, a] - body[:, b], axis=-1) for a, b in ((knee, hip), (ankle, knee)))
        direction = unit(reach)
        bend = body[:, knee] - body[:, hip] + (0.0 if knees is None else knees)
        bend = unit(bend - (bend * direction).sum(-1, keepdims=True) * direction)
        out[:, knee], _ = two_bones(out[:, hip], reach, bend, *bones)
    return out


def turn_about(points: DoubleArray, pivot: DoubleArray, axis: DoubleArray, angle: DoubleArray) -> DoubleArray:
    """Turn points (frames, joints, 3) about an axis (frames, 3) through a pivot (frames, 3) by angles (frames,)."""
    axis, local = axis[:, None], points - pivot[:, None]
    cos, sin = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    along = (local * axis).sum(-1, keepdims=True) * axis
    # Rodrigues' formula
    return pivot[:, None] + local * cos + np.cross(axis, local) * sin + along * (1 - cos)


def unit(vectors: DoubleArray) -> DoubleArray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True).clip(min=1e-9)


def slerp(start: DoubleArray, end: DoubleArray, weight: DoubleArray) -> DoubleArray:
    """Turn unit vectors (t, 3) into others along the great circle; opposite ones go by the straight line."""
    cosine = np.clip((start * end).sum(-1), -1.0, 1.0)
    angle = np.arccos(cosine)
    near = (angle < 1e-3) | (angle > np.pi - 1e-2)
    sine = np.where(near, 1.0, np.sin(angle))
    first = np.where(near, 1.0 - weight, np.sin((1 - weight) * angle) / sine)
    second = np.where(near, weight, np.sin(weight * angle) / sine)
    return first[:, None] * start + second[:, None] * end
