"""Energies of a motion: zero where it does what is wanted, and gradients that are those of finite differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kinegraph.arrays import DoubleArray
from kinegraph.motion import energies
from kinegraph.motion.energies import Energy
from kinegraph.motion.skeleton import HORIZONTAL, JOINT_INDEX, PELVIS, facing_angle
from support.motions import turn, walk

RNG = np.random.default_rng(0)
MOTION = walk(24, turning=0.05).astype(np.float64) + RNG.normal(0.0, 0.03, (24, 22, 3))
POSE = walk(4, speed=0.1).astype(np.float64) + RNG.normal(0.0, 0.05, (4, 22, 3))

TERMS: dict[str, Callable[[DoubleArray], Energy]] = {
    "position": lambda joints: energies.position_energy(
        joints, np.full(joints.shape, 0.4), np.linspace(0.0, 2.0, joints.size).reshape(joints.shape)
    ),
    "heading": lambda joints: energies.heading_energy(joints, np.linspace(0.0, 3.0, 24), np.linspace(0.0, 1.0, 24)),
    "pose at the start": lambda joints: energies.pose_energy(
        joints, POSE, 0, 0, np.linspace(0.5, 1.0, 4), np.linspace(1.0, 3.0, 3)
    ),
    "pose at the end": lambda joints: energies.pose_energy(
        joints, POSE, 20, 23, np.linspace(0.5, 1.0, 4), np.linspace(1.0, 3.0, 3)
    ),
    "pose at a moment": lambda joints: energies.pose_energy(joints, POSE[:1], 11, 11, np.ones(1), np.zeros(0)),
    "relative": lambda joints: energies.relative_energy(
        joints, np.full(joints.shape, 0.2), np.linspace(0.0, 1.0, 24 * 22).reshape(24, 22)
    ),
    "loop": lambda joints: energies.loop_energy(joints, 1.5, 4.0),
    "floor": lambda joints: energies.floor_energy(joints - [0.0, 0.05, 0.0], 2.0),
    "stance": lambda joints: energies.stance_energy(joints, np.linspace(0.0, 1.0, 46).reshape(23, 2)),
}


@pytest.mark.parametrize("name", TERMS)
def test_a_gradient_is_that_of_finite_differences(name: str) -> None:
    value, gradient = TERMS[name](MOTION)
    assert value > 0 and gradient.shape == MOTION.shape and np.abs(gradient).max() > 1e-4
    rng = np.random.default_rng(1)
    for _ in range(8):
        direction = rng.normal(size=MOTION.shape)
        ends = [TERMS[name](MOTION + sign * 1e-6 * direction)[0] for sign in (1, -1)]
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx((gradient * direction).sum(), rel=1e-4, abs=1e-6)


def test_what_is_as_wanted_has_no_energy() -> None:
    assert energies.position_energy(MOTION, MOTION, np.ones(MOTION.shape))[0] == 0
    angle = facing_angle(MOTION.astype(np.float32))
    assert energies.heading_energy(MOTION, angle, np.ones(24))[0] == pytest.approx(0, abs=1e-9)
    # a heading a whole turn away is the same heading
    assert energies.heading_energy(MOTION, angle + 2 * np.pi, np.ones(24))[0] == pytest.approx(0, abs=1e-9)
    assert energies.floor_energy(np.abs(MOTION), 1.0)[0] == 0
    still = np.repeat(MOTION[:1], 24, axis=0)
    assert energies.stance_energy(still, np.ones((23, 2)))[0] == 0
    assert energies.loop_energy(still, 1.0, 1.0)[0] == pytest.approx(0, abs=1e-12)


def test_a_pose_counts_wherever_it_is() -> None:
    heading = float(facing_angle(MOTION[[23]].astype(np.float32))[0])
    there = (MOTION[20:] - MOTION[23, PELVIS] * HORIZONTAL) @ turn("y", -heading).T
    assert energies.pose_energy(MOTION, there, 20, 23, np.ones(4), np.ones(3))[0] == pytest.approx(0, abs=1e-9)
    moved = MOTION @ turn("y", 2.0).T + [3.0, 0.0, -1.0]
    for pose in (there, POSE):
        here, away = (
            energies.pose_energy(joints, pose, 20, 23, np.ones(4), np.ones(3))[0] for joints in (MOTION, moved)
        )
        assert away == pytest.approx(here, rel=1e-6, abs=1e-9)
    raised = MOTION + np.array([0.0, 0.1, 0.0])
    assert energies.pose_energy(raised, there, 20, 23, np.ones(4), np.zeros(3))[0] == pytest.approx(
        0.5 * 88 * 0.01, rel=1e-6
    )


def test_a_loop_wants_the_velocity_too() -> None:
    there = np.zeros((9, 22, 3)) + MOTION[:1]
    there[4, JOINT_INDEX["left_wrist"], 1] += 0.2  # a gesture in the middle: no matter
    assert energies.loop_energy(there, 1.0, 1.0)[0] == pytest.approx(0, abs=1e-12)
    there[1, JOINT_INDEX["left_wrist"], 1] += 0.1  # the first step goes up, the last one does not
    assert energies.loop_energy(there, 1.0, 0.0)[0] == pytest.approx(0, abs=1e-12)
    assert energies.loop_energy(there, 1.0, 3.0)[0] == pytest.approx(0.5 * 3.0 * 0.01)
