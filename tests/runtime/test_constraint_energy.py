"""Energies of constraints: the velocity of a start or end pose goes on beside it."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.constraints import EndPose, Loop, StartPose
from kinegraph.diffusion.constraint_energy import SEAM_WEIGHT, seam_terms, total_energy
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
