"""What is known of a motion's features: poses, steps between them, and places that its steps have to lead to."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.keeping import PARTS
from kinegraph.motion.features import ROOT_VELOCITY, WIDTH, YAW_VELOCITY, features_from_joints, joints_from_features
from kinegraph.motion.known_features import (
    WHOLE_BODY,
    Anchor,
    KnownFeatures,
    columns_of_poses,
    columns_of_steps,
    lead_root,
)
from kinegraph.motion.skeleton import facing_angle
from support.motions import walk


def test_poses_and_steps_are_all_columns_and_none_twice() -> None:
    poses, steps = columns_of_poses(WHOLE_BODY), columns_of_steps(WHOLE_BODY)
    assert (poses ^ steps).all() and poses.sum() == 64 and steps.sum() == 73
    arm = PARTS["right arm"]
    assert columns_of_poses(arm).sum() == columns_of_steps(arm).sum() == 12
    legs = PARTS["legs"]
    assert columns_of_poses(legs).sum() == 1 + 8 * 3 and columns_of_steps(legs).sum() == 3 + 9 * 3 + 4


def test_a_motion_is_known_but_for_the_step_out_of_it() -> None:
    motion = walk(20, turning=0.02)
    known = KnownFeatures.nothing(32).with_poses(motion, 8)
    expected = np.zeros((32, WIDTH), dtype=bool)
    expected[8:28] = True
    expected[27, columns_of_steps(WHOLE_BODY)] = False
    np.testing.assert_array_equal(known.known, expected)
    rows = features_from_joints(motion)
    np.testing.assert_array_equal(known.values[8:28][expected[8:28]], rows[expected[8:28]])
    np.testing.assert_array_equal(known.free_steps, ~expected[:, 1])


def test_what_is_known_later_goes_before_and_leaves_the_rest() -> None:
    first, second = walk(20), walk(20, speed=0.1, swing=0.9)
    legs = KnownFeatures.nothing(20).with_poses(first, 0, PARTS["legs"])
    both = legs.with_poses(second[5:7], 5)
    assert not both.known[4, columns_of_poses(PARTS["arms"])].any() and both.known[5:7].sum() == 2 * 64 + 73 + 34
    np.testing.assert_allclose(both.values[5, ROOT_VELOCITY][1], 0.1, atol=2e-3)
    np.testing.assert_array_equal(both.values[6, ROOT_VELOCITY], legs.values[6, ROOT_VELOCITY])  # the step of the legs
    still = KnownFeatures.nothing(20).with_poses(first[:1], 3, PARTS["arms"], moving=False)
    assert still.known.sum() == 24 and not still.known[:, columns_of_steps(WHOLE_BODY)].any()


def shaken(frames: int = 40) -> np.ndarray:
    features = features_from_joints(walk(frames, turning=0.03)).astype(np.float64)
    return features + 0.02 * np.random.default_rng(3).standard_normal(features.shape)


def test_the_root_comes_by_and_known_steps_stay() -> None:
    features, free = shaken(), np.ones(40, dtype=bool)
    free[[0, 1, 2, 20, 21]] = False
    anchors = [Anchor(12, (0.3, 0.9), 0.8), Anchor(20, (0.1, 1.4), -0.4), Anchor(39, (-1.0, 2.0), 3.0)]
    led = lead_root(features, free, anchors)
    joints = joints_from_features(led)
    headings = np.concatenate([[0.0], np.cumsum(led[:, 0])])
    for anchor in anchors:
        np.testing.assert_allclose(joints[anchor.frame, 0, [0, 2]], anchor.position, atol=1e-5)
        turn = headings[anchor.frame] - anchor.heading
        assert np.cos(turn) == pytest.approx(1, abs=1e-9)
    steps = columns_of_steps(WHOLE_BODY)
    np.testing.assert_array_equal(led[~free][:, steps], features[~free][:, steps])
    np.testing.assert_array_equal(led[:, columns_of_poses(WHOLE_BODY)], features[:, columns_of_poses(WHOLE_BODY)])


def test_the_change_is_the_least_one() -> None:
    """Against the pseudoinverse: headings first, then places with these headings."""
    features, free = shaken(), np.ones(40, dtype=bool)
    free[[3, 4, 9]] = False
    anchor = Anchor(30, (0.5, 2.0), 0.5)
    led = lead_root(features, free, [anchor])
    steps = np.flatnonzero(free[:30])
    turn = anchor.heading - features[:30, 0].sum()
    np.testing.assert_allclose(
        led[steps, 0] - features[steps, 0], np.linalg.pinv(np.ones((1, len(steps))))[:, 0] * turn
    )
    headings = np.concatenate([[0.0], np.cumsum(led[:29, 0])])
    blocks = [np.array([[np.cos(h), np.sin(h)], [-np.sin(h), np.cos(h)]]) for h in headings]
    place = sum(block @ row for block, row in zip(blocks, features[:30, ROOT_VELOCITY], strict=True))
    sums = np.concatenate([blocks[step] for step in steps], axis=1)
    least = np.linalg.pinv(sums) @ (np.array(anchor.position) - place)
    np.testing.assert_allclose((led - features)[steps][:, ROOT_VELOCITY].ravel(), least, atol=1e-9)


def test_a_place_without_a_heading_leaves_the_heading() -> None:
    features = shaken()
    led = lead_root(features, np.ones(40, dtype=bool), [Anchor(10, (0.2, 0.6), None), Anchor(30, (0.5, 2.0), None)])
    np.testing.assert_array_equal(led[:, 0], features[:, 0])
    places = joints_from_features(led)[:, 0, [0, 2]]
    np.testing.assert_allclose(places[[10, 30]], [(0.2, 0.6), (0.5, 2.0)], atol=1e-5)


def test_a_motion_that_comes_by_stays_and_what_no_step_leads_to_is_missed() -> None:
    motion = walk(30, turning=0.04)
    features = features_from_joints(motion)
    anchor = Anchor.of(motion[17], 17)
    assert anchor.heading == pytest.approx(float(facing_angle(motion)[17]), abs=1e-6)
    np.testing.assert_allclose(lead_root(features, np.ones(30, dtype=bool), [anchor]), features, atol=1e-5)
    elsewhere = Anchor(17, (5.0, 5.0), 0.0)
    np.testing.assert_array_equal(lead_root(features, np.zeros(30, dtype=bool), [elsewhere]), features)


def test_an_anchor_replaces_that_of_its_frame() -> None:
    first, again = Anchor(4, (0.0, 1.0), 0.0), Anchor(4, (1.0, 1.0), 0.0)
    known = KnownFeatures.nothing(8).with_anchor(Anchor(6, (0.0, 0.0), 0.0)).with_anchor(first).with_anchor(again)
    assert [anchor.frame for anchor in known.anchors] == [4, 6] and known.anchors[0] == again
    assert known.free_steps.all() and YAW_VELOCITY.stop == ROOT_VELOCITY.start
