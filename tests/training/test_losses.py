"""Losses on motions whose loss is known: of reconstructions, and the spectral loss of denoised latents."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from support.motions import walk

torch = pytest.importorskip("torch")

from kinegraph.motion import features as layout
from kinegraph.motion.features import features_from_joints
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph_training.latents import TrainedVae
from kinegraph_training.losses import (
    ReconstructionWeights,
    SpectralMotionLoss,
    amplitude_spectrum,
    denoise,
    reconstruction_terms,
)

WRIST = JOINT_INDEX["right_wrist"]
WRIST_X = layout.POSITIONS.start + 3 * (WRIST - 1)
HZ = 2.5
FRAMES = 61
CENTRE, SCALE = torch.tensor([[0.1, 0.0]]), torch.tensor([[0.5, 2.0]])


def swinging(phase: float, size: float, frames: int = 64) -> np.ndarray:
    """Make (frames, 22, 3) whose right wrist swings sideways, `size` metres either way; nothing else moves."""
    joints = np.repeat(walk(1), frames, axis=0)
    joints[:, WRIST, 0] += size * np.sin(2 * np.pi * HZ * np.arange(frames) / 20 + phase)
    return joints.astype(np.float32)


@pytest.mark.parametrize("window", [16, 32])
def test_the_spectrum_is_that_of_numpy_and_reads_metres(window: int) -> None:
    joints = swinging(0.4, 0.2)
    amplitudes = amplitude_spectrum(torch.from_numpy(joints[None]), window).numpy()[0]
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(window) / window)
    for number, start in enumerate(range(0, 64 - window + 1, window // 2)):
        rows = joints[start : start + window].reshape(window, 66)
        expected = np.abs(np.fft.rfft(rows * hann[:, None], axis=0))[1:].T * 4 / window
        assert np.allclose(amplitudes[number], expected, atol=3e-4)
    # 2.5 Hz is bin 2 of 16 frames and bin 4 of 32
    assert amplitudes[:, 3 * WRIST, int(HZ * window / 20) - 1] == pytest.approx(0.2, rel=0.02)


def terms(predicted: np.ndarray, target: np.ndarray) -> dict[str, float]:
    rows = [torch.from_numpy(features_from_joints(joints))[None] for joints in (predicted, target)]
    values = reconstruction_terms(*rows, torch.ones(1, 64), torch.ones(137), torch.zeros(137), ReconstructionWeights())
    return {name: value.item() for name, value in values.items()}


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
    rest = (torch.ones(137), torch.zeros(137), ReconstructionWeights())
    padded = reconstruction_terms(broken, rows, mask, *rest)
    assert padded["spectra_16"] == 0 and padded["spectra_32"] == 0
    short = reconstruction_terms(rows[:, :12], rows[:, :12], mask[:, :12], *rest)
    assert "spectra_16" not in short


class Waving(torch.nn.Module):
    """Decoder of (b, 1, 2), size in metres and phase, to a standing figure that waves the right hand at 2.5 Hz."""

    config = SimpleNamespace(frames_per_token=4)

    def decode(self, latent: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        frames = mask.shape[1]
        still = torch.from_numpy(features_from_joints(np.repeat(walk(1), frames, axis=0)))
        rows = still[None].repeat(len(latent), 1, 1)
        size, phase = latent[:, 0, :1], latent[:, 0, 1:]
        wave = size * torch.sin(2 * torch.pi * 2.5 * torch.arange(frames) / 20 + phase)
        return torch.cat([rows[..., :WRIST_X], rows[..., WRIST_X, None] + wave[..., None], rows[..., WRIST_X + 1 :]], 2)


def spectral_loss() -> SpectralMotionLoss:
    plain = np.zeros(137, dtype=np.float32)
    return SpectralMotionLoss(TrainedVae(Waving(), plain, plain + 1), CENTRE, SCALE)  # type: ignore[arg-type]


def latent(size: float, phase: float = 0.0) -> torch.Tensor:
    return ((torch.tensor([[size, phase]]) - CENTRE) / SCALE)[None]


def test_a_prediction_is_denoised_as_ddim_does_it() -> None:
    generator = torch.Generator().manual_seed(0)
    target, noise, predicted = (torch.randn(3, 2, 4, generator=generator) for _ in range(3))
    alpha = torch.tensor([0.9, 0.5, 0.1])[:, None, None]
    noisy = alpha.sqrt() * target + (1 - alpha).sqrt() * noise
    expected = (noisy - (1 - alpha).sqrt() * predicted) / alpha.sqrt()
    torch.testing.assert_close(denoise(target, noise, predicted, alpha), expected)
    torch.testing.assert_close(denoise(target, noise, noise, alpha), target)


def test_how_far_a_hand_swings_counts_and_when_it_does_does_not() -> None:
    frames = torch.tensor([FRAMES])
    same, late, half = (
        spectral_loss()(wave, latent(0.2), frames) for wave in (latent(0.2), latent(0.2, 1.5), latent(0.1))
    )
    assert same.item() == pytest.approx(0.0, abs=1e-5) and late < 0.4 * half
    # A wave 0.1 m too small: bin 4 of 32 frames with its Hann neighbours of half its height, 0.2 m of one of 66
    # coordinates; of 16 frames bins 2 and 3, while bin 1 holds mostly where the hand is held.
    assert half.item() == pytest.approx((0.2 + 0.16) / 66, rel=0.03)


def test_it_pulls_towards_the_true_reach() -> None:
    for size, sign in ((0.1, -1), (0.3, 1)):
        wave = latent(size).requires_grad_()
        spectral_loss()(wave, latent(0.2), torch.tensor([FRAMES])).backward()
        assert wave.grad is not None and wave.grad[0, 0, 0].sign() == sign


def test_short_clips_and_padding_have_no_say() -> None:
    assert spectral_loss()(latent(0.1), latent(0.2), torch.tensor([12])).item() == 0.0
    both = torch.cat([latent(0.1), latent(0.1)]), torch.cat([latent(0.2), latent(0.2)])
    alone = spectral_loss()(latent(0.1), latent(0.2), torch.tensor([FRAMES]))
    torch.testing.assert_close(spectral_loss()(*both, torch.tensor([FRAMES, 40])), alone, rtol=0.02, atol=0)
