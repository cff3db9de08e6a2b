"""Limbs turned about their own length: known turns come back, recorded ones bend about their hinges and never flip."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.motion import quaternions as q
from kinegraph.motion.kinematics import HINGES, apply_twist, spine_twist
from kinegraph.motion.skeleton import JOINT_INDEX
from support.motions import largest_twist, posed, recorded, turn, walk, world_turns


def still(turns: dict[int, np.ndarray], frames: int = 6) -> np.ndarray:
    return np.repeat(posed(np.zeros(3), turns)[None], frames, axis=0).astype(np.float32)


@pytest.mark.parametrize("angle", [-1.0, -0.3, 0.0, 0.5, 1.2])
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_bent_arm_and_leg_show_how_they_are_turned(angle: float, side: str) -> None:
    sign = 1.0 if side == "left" else -1.0
    shoulder = turn("z", -0.9 * sign) @ turn("y", 0.4) @ turn("x", angle)
    hip = turn("x", -0.3) @ turn("y", angle)
    index = {part: JOINT_INDEX[f"{side}_{part}"] for part in ("shoulder", "elbow", "hip", "knee")}
    bends = {index["elbow"]: turn("y", -0.9 * sign), index["knee"]: turn("x", 0.8)}
    solved = q.to_matrix(world_turns(still({index["shoulder"]: shoulder, index["hip"]: hip, **bends})))
    # a tenth of the say is left to the shortest turn
    for part, true in (("shoulder", shoulder), ("hip", hip)):
        found = solved[3, index[part]]
        assert np.degrees(np.arccos((np.trace(found @ true.T) - 1) / 2)) < 8.0, part
        inner = solved[3, index["elbow" if part == "shoulder" else "knee"]]
        bend = found.T @ inner
        assert abs(np.degrees(np.arccos((np.trace(bend) - 1) / 2)) - np.degrees(0.9 if part == "shoulder" else 0.8)) < 1


def test_a_straight_limb_takes_the_shortest_turn() -> None:
    turns = world_turns(still({JOINT_INDEX["left_shoulder"]: turn("z", -1.1)}))
    found = q.to_matrix(turns[0, JOINT_INDEX["left_shoulder"]])
    # shortest from the collar, which the solved rest pose puts a little differently
    assert np.degrees(np.arccos((np.trace(found @ turn("z", -1.1).T) - 1) / 2)) < 10.0


def test_a_limb_that_bends_for_a_while_is_turned_without_a_jump() -> None:
    left = JOINT_INDEX["left_shoulder"]
    bend = 0.9 * np.clip(np.sin(np.linspace(-2, 5, 80)), 0, 1)
    joints = np.stack(
        [posed(np.zeros(3), {left: turn("x", 1.4), JOINT_INDEX["left_elbow"]: turn("y", -b)}) for b in bend]
    ).astype(np.float32)
    turns = world_turns(joints)[:, left]
    step = np.degrees(2 * np.arccos(np.abs((turns[1:] * turns[:-1]).sum(-1)).clip(0, 1)))
    assert step.max() < 25 and step.sum() < 2.5 * np.degrees(1.4)


@pytest.mark.parametrize("angle", [-0.9, 0.0, 0.6])
def test_the_spine_shares_what_the_chest_is_turned(angle: float) -> None:
    solved = q.to_matrix(world_turns(still({JOINT_INDEX["spine3"]: turn("y", angle)})))[2]
    heading = [np.arctan2(solved[JOINT_INDEX[name], 0, 2], solved[JOINT_INDEX[name], 2, 2]) for name in
               ("pelvis", "spine1", "spine2", "spine3")]  # fmt: skip
    np.testing.assert_allclose(heading, np.linspace(0, angle, 4), atol=0.03)


def test_the_twist_of_a_turn_is_that_of_the_textbook() -> None:
    angle = np.array([-3.0, -1.0, 0.0, 0.5, 3.0])
    lean = q.about_axis(0, np.full(5, 0.4))
    chest = q.multiply(lean, q.about_axis(1, angle))
    np.testing.assert_allclose(spine_twist(np.tile(q.IDENTITY, (5, 1)), chest), angle, atol=1e-9)
    np.testing.assert_allclose(spine_twist(np.tile(q.IDENTITY, (5, 1)), -chest), angle, atol=1e-9)
    swing = q.about_axis(2, np.full(5, 0.3))
    bone = np.array([0.0, 2.0, 0.0])
    np.testing.assert_allclose(q.rotate(apply_twist(swing, bone, angle), bone), q.rotate(swing, bone), atol=1e-9)


def test_a_limb_that_flips_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert largest_twist(walk(40)) < 45
    monkeypatch.setattr(
        "kinegraph.motion.kinematics.hinge_twist", lambda _, goal, *rest, **more: np.pi * (np.arange(len(goal)) == 20)
    )
    assert largest_twist(walk(40)) > 150


def test_recorded_limbs_bend_about_their_hinges_and_never_flip() -> None:
    apart = []
    for joints in recorded(count=60):
        turns = world_turns(joints)
        assert largest_twist(joints) < 45
        for joint, (middle, end, axis) in HINGES.items():
            upper = q.normalised(joints[:, middle] - joints[:, joint]).astype(np.float64)
            lower = q.normalised(joints[:, end] - joints[:, middle]).astype(np.float64)
            plane = np.cross(upper, lower)
            bent = np.linalg.norm(plane, axis=-1) > 0.35
            cosine = (q.rotate(turns[:, joint], np.array(axis)) * q.normalised(plane)).sum(-1)
            apart.append(np.degrees(np.arccos(cosine.clip(-1, 1)))[bent])
    # with the shortest turn alone: 33 degrees on half of the arms' frames, up to 99
    assert np.quantile(np.concatenate(apart), 0.95) < 10 and np.concatenate(apart).max() < 40
