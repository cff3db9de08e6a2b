"""Energies of constraints: the velocity of a start or end pose goes on beside it."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.constraints import Constraint, EndPose, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.diffusion.constraint_energy import SEAM_WEIGHT, constraint_terms, seam_terms, total_energy
from support.motions import t_pose

FPS, FRAMES, STEP = 20.0, 12, 0.03
GLIDE = t_pose(FRAMES).astype(np.float64) + np.arange(FRAMES)[:, None, None] * [0.0, 0.0, STEP]
"""A body that moves ahead at an even speed."""


@pytest.mark.parametrize(("kind", "beside", "poses"), [(StartPose, 4, slice(0, 4)), (EndPose, 7, slice(8, 12))])
def test_the_velocity_of_a_pose_goes_on(kind: type[StartPose | EndPose], beside: int, poses: slice) -> None:
    constraint = kind(GLIDE[poses].astype(np.float32), weight=2.0)
    terms = seam_terms([constraint, Loop()], FRAMES, FPS)
    assert len(terms) == 1 and total_energy(terms, GLIDE)[0] == pytest.approx(0, abs=1e-9)
    stops = GLIDE.copy()
    stops[beside, :, 2] += 0.2
    energy, gradient = total_energy(terms, stops)
    assert energy == pytest.approx(0.5 * SEAM_WEIGHT * 2.0 * 0.2**2, rel=1e-3)
    rng = np.random.default_rng(0)
    for _ in range(4):
        direction = rng.normal(size=stops.shape)
        ends = [total_energy(terms, stops + sign * 1e-6 * direction)[0] for sign in (1, -1)]
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx((gradient * direction).sum(), rel=1e-4)


def test_what_has_no_velocity_or_no_weight_has_no_seam() -> None:
    still, weak = StartPose(GLIDE[:1].astype(np.float32)), EndPose(GLIDE[:4].astype(np.float32), weight=0.0)
    whole = StartPose(GLIDE.astype(np.float32))
    assert seam_terms([still, weak, whole], FRAMES, FPS) == ()


STILL = t_pose(40).astype(np.float64)
MOVED = STILL + np.array([0.3, 0.0, 0.4])
"""Half a metre off, everywhere."""
HEAD = tuple(STILL[0, 15].tolist())
WANTED: list[Constraint] = [
    Path(STILL[:, 0][:, [0, 2]], times=np.arange(40) / FPS, weight=2),
    Path(STILL[:10, 0][:, [0, 2]], times=np.arange(10) / FPS, weight=2),
    Waypoint(1.0, (0, 0), weight=2),
    JointTarget("head", HEAD, (0.5, 1.5), weight=2),
    JointTarget("head", HEAD, 1.0, weight=2),
    JointTarget("head", (HEAD[0], None, HEAD[2]), 1.0, weight=2),
    Keyframe(1.0, t_pose(1)[0], weight=2),
    StartPose(t_pose(4), weight=2),
    EndPose(t_pose(4), weight=2),
    Loop(weight=2),
]


@pytest.mark.parametrize("constraint", WANTED[:7], ids=lambda constraint: type(constraint).__name__)
def test_a_term_is_half_the_mean_square_of_its_miss_times_its_weight(constraint: Constraint) -> None:
    (term,) = constraint_terms([constraint], len(STILL), FPS)
    assert term(STILL)[0] == pytest.approx(0, abs=1e-9)
    assert term(MOVED)[0] == pytest.approx(0.5 * 2 * 0.5**2, rel=1e-6)


@pytest.mark.parametrize("constraint", WANTED[7:], ids=lambda constraint: type(constraint).__name__)
def test_what_may_be_anywhere_costs_nothing_wherever_it_is(constraint: Constraint) -> None:
    (term,) = constraint_terms([constraint], len(STILL), FPS)
    place = 0.0 if isinstance(constraint, StartPose) else 0.5  # a clip begins at the origin
    assert term(STILL + np.array([place, 0.0, 0.0]))[0] == pytest.approx(0, abs=1e-9)
    raised = STILL.copy()
    raised[:4] += [0.0, 0.3, 0.0]
    raised[-4:] += [0.0, 0.3, 0.0]
    if isinstance(constraint, Loop):
        raised[:4] -= [0.0, 0.3, 0.0]  # its ends differ
    assert term(raised)[0] == pytest.approx(0.5 * 2 * 0.3**2, rel=1e-6)
