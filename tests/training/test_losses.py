"""What an autoencoder's reconstruction is held to, on motions whose loss is known."""

from __future__ import annotations

import numpy as np
import pytest

from support.motions import walk

torch = pytest.importorskip("torch")

from kinegraph.motion.features import features_from_joints
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph_training.losses import ReconstructionLoss, reconstruction_terms, spectrum

WRIST = JOINT_INDEX["right_wrist"]
HZ = 2.5


def swinging(phase: float, size: float, frames: int = 64) -> np.ndarray:
    """(frames, 22, 3): the right wrist swings sideways, `size` metres either way; nothing else moves."""
    joints = np.repeat(walk(1), frames, axis=0)
    joints[:, WRIST, 0] += size * np.sin(2 * np.pi * HZ * np.arange(frames) / 20 + phase)
    return joints.astype(np.float32)


@pytest.mark.parametrize("window", [16, 32])
def test_the_spectrum_is_that_of_numpy_and_reads_metres(window: int) -> None:
    joints = swinging(0.4, 0.2)
    found = spectrum(torch.from_numpy(joints[None]), window).numpy()[0]
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(window) / window)
    for number, start in enumerate(range(0, 64 - window + 1, window // 2)):
        rows = joints[start : start + window].reshape(window, 66)
        expected = np.abs(np.fft.rfft(rows * hann[:, None], axis=0))[1:].T * 4 / window
        assert np.allclose(found[number], expected, atol=3e-4)
    # 2.5 Hz is bin 2 of 16 frames and bin 4 of 32
    assert found[:, 3 * WRIST, int(HZ * window / 20) - 1] == pytest.approx(0.2, rel=0.02)


def terms(predicted: np.ndarray, target: np.ndarray) -> dict[str, float]:
    rows = [torch.from_numpy(features_from_joints(joints))[None] for joints in (predicted, target)]
    found = reconstruction_terms(*rows, torch.ones(1, 64), torch.ones(137), torch.zeros(137), ReconstructionLoss())
    return {name: value.item() for name, value in found.items()}


def test_a_hand_that_stands_still_is_worse_than_one_out_of_phase_by_its_spectrum_and_in_all() -> None:
    target = swinging(0.0, 0.2)
    late, still = terms(swinging(np.pi / 2, 0.2), target), terms(swinging(0.0, 0.0), target)
    assert late["positions"] > still["positions"]
    for name in ("spectra_16", "spectra_32"):
        assert late[name] < 0.5 * still[name]
    assert sum(late.values()) < sum(still.values())


def test_frames_of_padding_have_no_spectrum() -> None:
    rows = torch.from_numpy(features_from_joints(swinging(0.0, 0.2)))[None]
    mask = torch.ones(1, 64)
    mask[:, 40:] = 0
    broken = rows.clone()
    broken[:, 40:] += 1.0
    given = (torch.ones(137), torch.zeros(137), ReconstructionLoss())
    found = reconstruction_terms(broken, rows, mask, *given)
    assert found["spectra_16"] == 0 and found["spectra_32"] == 0
    short = reconstruction_terms(rows[:, :12], rows[:, :12], mask[:, :12], *given)
    assert "spectra_16" not in short
