"""Made sitting: bodies sit on a seat, upright, with feet and bones as they were."""

from __future__ import annotations

import numpy as np
import pytest

from support.motions import posed

pytest.importorskip("torch")

from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths
from kinegraph_training.synthetic.posing import two_bones
from kinegraph_training.synthetic.sitting import BACK, SEAT, SITTING, seated_weight, sit

HIP, KNEE, ANKLE = (JOINT_INDEX[f"left_{name}"] for name in ("hip", "knee", "ankle"))
FEET = [JOINT_INDEX[f"{side}_{name}"] for side in ("left", "right") for name in ("ankle", "foot")]


def standing(frames: int = 100) -> np.ndarray:
    return np.stack([posed(np.array([0, 0.95, 0]), {}) for _ in range(frames)]).astype(np.float32)


def knee_degrees(body: np.ndarray) -> np.ndarray:
    """Angle of thigh and shin at the left knee, by the scalar product."""
    thigh, shin = body[:, HIP] - body[:, KNEE], body[:, ANKLE] - body[:, KNEE]
    cosine = (thigh * shin).sum(-1) / np.linalg.norm(thigh, axis=-1) / np.linalg.norm(shin, axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


@pytest.mark.parametrize("label", SITTING)
def test_the_hips_are_on_a_seat_where_the_label_says(label: str) -> None:
    body = standing()
    floor = body[:, :, 1].min()
    for seed in range(8):
        out = sit(body, label, np.random.default_rng(seed))
        height = out[:, HIP, 1] - floor
        seated = (height > SEAT[0] - 1e-3) & (height < SEAT[1] + 1e-3)
        begins, ends = label in ("sit", "stand-up"), label in ("sit", "sit-down")
        assert seated[0] == begins and seated[-1] == ends and seated.any()
        down = int(height.argmin())
        assert BACK[0] - 1e-3 < body[down, HIP, 2] - out[down, HIP, 2] < BACK[1] + 1e-3
        assert 60 < knee_degrees(out)[down] < 115
        np.testing.assert_array_equal(out[:, FEET], body[:, FEET])
        np.testing.assert_allclose(bone_lengths(out), bone_lengths(body), atol=2e-3)
        assert np.abs(np.diff(out, axis=0)).max() < 0.2


def test_the_trunk_leans_forward_on_the_way_and_is_upright_on_the_seat() -> None:
    neck = JOINT_INDEX["neck"]
    for seed in range(8):
        out = sit(standing(), "sit-down", np.random.default_rng(seed))
        trunk = out[:, neck] - out[:, [HIP, JOINT_INDEX["right_hip"]]].mean(1)
        lean = np.degrees(np.arctan2(trunk[:, 2], trunk[:, 1]))
        assert lean.max() > 15 and abs(lean[-1]) < 15 and lean.argmax() < len(out) - 5


def test_knees_never_bend_backwards() -> None:
    for seed in range(8):
        out = sit(standing(), "sit-down-and-stand-up", np.random.default_rng(seed))
        line = out[:, HIP] + 0.5 * (out[:, ANKLE] - out[:, HIP])
        assert (out[:, KNEE, 2] - line[:, 2] > -1e-3).all()


@pytest.mark.parametrize("label", SITTING)
def test_short_clips_have_room_for_all_of_it(label: str) -> None:
    for seed in range(20):
        weight = seated_weight(36, label, np.random.default_rng(seed))
        assert weight.shape == (36,) and weight.min() >= 0 and weight.max() > 0.97
        assert (weight[0] < 1e-6) == (label in ("sit-down", "sit-down-and-stand-up"))


def test_two_bones_meet_the_law_of_cosines() -> None:
    rng = np.random.default_rng(0)
    upper, lower = rng.uniform(0.3, 0.5, 20), rng.uniform(0.3, 0.5, 20)
    reach = rng.normal(size=(20, 3))
    reach *= (rng.uniform(0.25, 0.58, 20) / np.linalg.norm(reach, axis=-1))[:, None]
    bend = np.cross(reach, rng.normal(size=(20, 3)))
    bend /= np.linalg.norm(bend, axis=-1, keepdims=True)
    middle, end = two_bones(np.zeros((20, 3)), reach, bend, upper, lower)
    np.testing.assert_allclose(np.linalg.norm(middle, axis=-1), upper)
    np.testing.assert_allclose(np.linalg.norm(end - middle, axis=-1), lower)
    assert ((middle * bend).sum(-1) >= 0).all()
