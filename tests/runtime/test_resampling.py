"""Clips at another frame rate, and clips in place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph import cli
from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.motion.blending import canonical_poses
from kinegraph.motion.skeleton import bone_lengths, facing_angle
from support.cli_runs import fails
from support.motions import largest_twist, walk, with_recorded


def clip(joints: np.ndarray) -> Clip:
    return Clip(joints=joints, fps=20.0, seed=1, text="a person walks", bundle="edge 1.2")


def motions() -> list[np.ndarray]:
    return with_recorded([walk(60, turning=0.03)], 4)


@pytest.mark.parametrize("fps", [24, 30, 60, 20, 10])
def test_known_frames_stay_and_new_ones_lie_between(fps: float) -> None:
    for joints in motions():
        resampled = clip(joints).resampled(fps)
        assert resampled.fps == fps and abs(resampled.duration - len(joints) / 20) <= 0.5 / fps + 1e-9
        time = np.arange(resampled.frames) * 20 / fps
        known = np.flatnonzero((np.abs(time - time.round()) < 1e-9) & (time < len(joints)))
        np.testing.assert_allclose(resampled.joints[known], joints[time[known].round().astype(int)], atol=1e-5)
        # bones keep their length between frames, which a mix of joint positions would shorten
        lengths, original = bone_lengths(resampled.joints), bone_lengths(joints)
        assert (lengths > original.min(0) - 5e-3).all() and (lengths < original.max(0) + 5e-3).all()


def test_a_turn_is_made_on_its_arc() -> None:
    angle = np.array([0.0, 1.2])
    standing = walk(2, speed=0.0)[[0, 0]].astype(np.float64)
    around = np.stack(
        [
            standing[k] @ np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
            for k, a in enumerate(angle)
        ]
    )
    resampled = clip(around.astype(np.float32)).resampled(40)
    np.testing.assert_allclose(
        facing_angle(resampled.joints[:3]) - facing_angle(resampled.joints[:1]), [0, 0.6, 1.2], atol=1e-3
    )


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_limbs_twist_no_faster_at_other_frame_rates(fps: float) -> None:
    for joints in with_recorded([walk(60, turning=0.03)], 30):
        before = largest_twist(joints) * 20
        assert largest_twist(clip(joints).resampled(fps).joints, fps) * fps < 1.3 * before + 60


@pytest.mark.parametrize("fps", [0, -1, 241, float("nan"), float("inf"), "30", True, None])
def test_values_that_are_no_frame_rate_are_refused(fps: object) -> None:
    with pytest.raises(InvalidInputError, match="fps must be 1 to 240"):
        clip(walk(20)).resampled(fps)  # type: ignore[arg-type]


def test_in_place_takes_the_travel_and_nothing_else() -> None:
    for joints in motions():
        still = clip(joints).in_place().joints
        np.testing.assert_allclose(still[:, 0, [0, 2]], np.repeat(joints[:1, 0, [0, 2]], len(joints), 0), atol=1e-6)
        np.testing.assert_allclose(still[..., 1], joints[..., 1])
        np.testing.assert_allclose(canonical_poses(still), canonical_poses(joints), atol=1e-5)


@pytest.mark.usefixtures("toy_by_default")
def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("spacy")
    words = ["generate", "a person walks", "--steps", "2", "--seconds", "2", "--seed", "1", "--quiet"]
    plain, other = str(tmp_path / "a.npz"), str(tmp_path / "b.npz")
    assert cli.main([*words, "-o", plain]) == 0
    assert cli.main([*words, "--fps", "30", "--in-place", "--loop", "-o", other]) == 0
    with np.load(plain) as before, np.load(other) as after:
        expected = Clip(before["joints"], 20.0, 1, "a person walks", "b").looped().in_place().resampled(30)
        np.testing.assert_allclose(after["joints"], expected.joints, atol=1e-6)
        assert after["fps"] == 30 and before["fps"] == 20
    assert "fps must be 1 to 240" in fails(capsys, *words, "--fps", "0", "-o", str(tmp_path / "c.npz"))
