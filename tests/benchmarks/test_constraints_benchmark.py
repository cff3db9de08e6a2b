"""Cases for constraints are met by the clips that they are drawn from; misses are told on known motions."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph import EndPose, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.feasibility import check_constraints
from kinegraph.motion.skeleton import bone_lengths
from kinegraph.placements import misses_of, pins_of
from kinegraph_benchmarks.common.constraint_cases import FIRST_SEED, KINDS, make_cases, on_common_body
from kinegraph_benchmarks.common.predicates import FPS
from kinegraph_benchmarks.quality.constraints import (
    ALONE_GOALS,
    asked_motion,
    goals_met,
    miss,
    seam_limits,
    seam_motion,
    seams,
    step_motion,
    summarise,
    waypoints_of,
)
from kinegraph_training.data.clips import MotionClip
from support.motions import stand, t_pose, walk


def clip(label: str, joints: np.ndarray) -> MotionClip:
    return MotionClip(label, joints.astype(np.float32), ("a person moves.",), (label,), "normal")


CLIPS = [
    clip("walk", walk(100)),
    clip("run", walk(60, speed=0.12)),
    clip("bow", stand(60, bow=1.2)),
    clip("walk-turn-left", walk(80, turning=0.02)),
    clip("raise-up-right-hand", stand(50, wave=2.4, rate=0.0)),
]
CASES = make_cases(CLIPS, 3)


def test_every_kind_has_cases_with_seeds_of_their_own() -> None:
    assert set(CASES) == set(KINDS) and set(ALONE_GOALS) < set(KINDS)
    seeds = [case.seed for cases in CASES.values() for case in cases]
    assert len(seeds) == len(set(seeds)) == 3 * len(KINDS) and min(seeds) >= FIRST_SEED


@pytest.mark.parametrize("kind", KINDS)
def test_a_person_can_do_what_is_asked(kind: str) -> None:
    for case in CASES[kind]:
        assert check_constraints(case.constraints, round(case.seconds * FPS), FPS, strict=True)[1] == ()


@pytest.mark.parametrize("kind", ["path", "waypoint", "hand", "foot", "keyframe", "keyframe + straight"])
def test_the_clip_that_a_case_is_drawn_from_meets_it(kind: str) -> None:
    for case in CASES[kind]:
        assert case.captured is not None and len(case.captured) == round(case.seconds * FPS)
        # paths are straight between their points, of which there are four a second
        assert max(miss(case.captured, wanted) for wanted in case.constraints) < 0.005, case


def test_misses_are_metres() -> None:
    joints = walk(41, speed=0.05)  # forward by 5 cm a frame
    root = joints[0, 0]
    assert miss(joints, Waypoint(1, (0.3, 1.4))) == pytest.approx(0.5, abs=0.01)
    assert miss(joints, Path([(0.3, 0), (0.3, 2)])) == pytest.approx(0.3, abs=0.01)
    high = JointTarget("pelvis", (None, float(root[1]) + 0.2, None), (0, 2))
    assert miss(joints, high) == pytest.approx(0.2, abs=0.05)
    moved = joints[10] + np.array([0.0, 0.0, 0.4], dtype=np.float32)
    assert miss(joints, Keyframe(0.5, moved)) == pytest.approx(0.4, abs=1e-5)
    assert miss(joints, Keyframe(0.5, moved, anywhere=True)) == pytest.approx(0, abs=1e-5)
    assert miss(joints, StartPose(joints[:4])) < 0.05
    assert miss(joints, EndPose(joints[-4:] + np.float32(0.0))) == pytest.approx(0, abs=1e-5)
    assert miss(t_pose(30), Loop()) == pytest.approx(0, abs=1e-6)
    assert miss(np.concatenate([t_pose(10), stand(10, bow=1.0)]), Loop()) > 0.05


def test_waypoints_of_a_path_lie_on_it() -> None:
    case = CASES["drawn path"][0]
    points = waypoints_of(case, 4)
    assert len(points) == 4 and points[-1].seconds == pytest.approx(case.seconds - 1 / FPS)
    (path,) = case.constraints
    assert isinstance(path, Path)
    np.testing.assert_allclose(points[-1].position, path.points[-1], atol=1e-9)


def test_a_summary_tells_which_goals_are_met() -> None:
    arm = {"miss": 0.004, "worst": 0.004, "cpu": 0.5, "holds": True, "jerk": 1.1, "skate": 1.0}
    rows = [{"plain": {"miss": 1.0, "worst": 1.0, "cpu": 0.1, "holds": True}, "alone": arm, "corrected": arm}]
    summary = summarise(rows)
    assert summary["corrected"]["time"] == pytest.approx(5) and summary["corrected"]["text_kept"] == 1
    assert all(goals_met("path", summary).values()) and "captured" not in summary
    beside = summarise([rows[0] | {"captured": {"jerk": jerk, "skate": 1.0}} for jerk in (1.0, 2.0, 3.0)])
    assert beside["captured"] == {"jerk": 2.0, "skate": 1.0}
    for change, goal in (({"miss": 0.04}, "corrected"), ({"jerk": 1.4}, "jerk"), ({"cpu": 0.7}, "time")):
        worse = summarise([rows[0] | {"corrected": arm | change}])
        assert not goals_met("path", worse)[goal]


def test_captured_clips_are_put_on_the_common_body() -> None:
    moved = on_common_body(CLIPS)
    lengths = [bone_lengths(one.joints).mean(axis=0) for one in moved]
    np.testing.assert_allclose(lengths[1:], lengths[:-1], atol=2e-3)
    assert [one.action for one in moved] == [one.action for one in CLIPS]


def test_a_seam_is_measured_where_what_is_asked_for_ends() -> None:
    joints = walk(40, speed=0.05)
    speed, change = step_motion(joints)
    assert speed.shape == (39,) and change.shape == (38,) and step_motion(t_pose(5))[0].max() == 0
    jumped = joints.copy()
    jumped[4:] += np.array([0.0, 0.0, 0.5], dtype=np.float32)  # 10 m/s
    start, end = StartPose(joints[:4]), EndPose(joints[-4:])
    assert seam_motion(jumped, start)[0] > speed[3] + 5 and seam_motion(jumped, start)[1] > change[2:4].max() + 5
    assert seam_motion(jumped, end) == pytest.approx(seam_motion(joints, end), abs=1e-4)
    jumped = joints.copy()
    jumped[-4:, :, 2] += 0.5
    assert seam_motion(jumped, end)[0] > 5 > seam_motion(jumped, start)[0]
    asked = asked_motion(StartPose(joints[:4]))
    assert asked[0] == pytest.approx(speed[:3].max(), rel=0.02) and asked_motion(StartPose(joints[:1])) == (0.0, 0.0)
    rows = [
        {arm: {"seam": value} for arm in ("plain", "alone", "corrected")} | {"asked_motion": (2.5, 1.0)}
        for value in ((1.0, 1.0), (2.4, 1.0), (3.0, 1.0))
    ]
    shares = seams(rows, (2.0, 2.0))["corrected"]
    assert shares["median"] == [2.4, 1.0]
    assert (shares["within"], shares["within_or_asked"]) == (pytest.approx(1 / 3), pytest.approx(2 / 3))
    limits = seam_limits(CLIPS)
    assert limits[0] > 0 and limits[1] > 0


@pytest.mark.parametrize("kind", KINDS)
def test_misses_told_with_clips_are_those_measured_here(kind: str) -> None:
    for case in CASES[kind]:
        joints = walk(round(case.seconds * FPS), turning=0.03).astype(np.float64)
        assert case.constraints
        for constraint in case.constraints:
            (told,) = misses_of([constraint], joints, FPS)
            assert told.metres == pytest.approx(miss(joints, constraint), abs=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_a_motion_that_is_pinned_misses_nothing(kind: str) -> None:
    for case in CASES[kind]:
        joints = walk(round(case.seconds * FPS), turning=0.03).astype(np.float64)
        for _ in range(8):  # places of ends and loops depend on where the motion is
            pins = pins_of(case.constraints, joints, FPS)
            joints = np.where(pins.wanted, pins.target, joints)
        assert max(miss(joints, constraint) for constraint in case.constraints) < 1e-3


def test_a_missed_heading_is_told_in_degrees() -> None:
    joints = walk(41).astype(np.float64)
    (told,) = misses_of([Waypoint(1, (0, 1), heading=30)], joints, FPS)
    assert told.degrees == pytest.approx(30, abs=8)  # shoulders sway
