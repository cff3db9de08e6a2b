"""Denoised latents are held to how strongly their clips' joints swing."""

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
from kinegraph_training.losses import SpectralMotionLoss, denoised

WRIST_X = layout.POSITIONS.start + 3 * (JOINT_INDEX["right_wrist"] - 1)
FRAMES = 61
CENTRE, SCALE = torch.tensor([[0.1, 0.0]]), torch.tensor([[0.5, 2.0]])


class Waving(torch.nn.Module):
    """Decodes (b, 1, 2), size in metres and phase, to somebody who stands and waves the right hand at 2.5 Hz."""

    config = SimpleNamespace(frames_per_token=4)

    def decode(self, latent: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        frames = mask.shape[1]
        still = torch.from_numpy(features_from_joints(np.repeat(walk(1), frames, axis=0)))
        rows = still[None].repeat(len(latent), 1, 1)
        size, phase = latent[:, 0, :1], latent[:, 0, 1:]
        wave = size * torch.sin(2 * torch.pi * 2.5 * torch.arange(frames) / 20 + phase)
        return torch.cat([rows[..., :WRIST_X], rows[..., WRIST_X, None] + wave[..., None], rows[..., WRIST_X + 1 :]], 2)


def swing() -> SpectralMotionLoss:
    plain = np.zeros(137, dtype=np.float32)
    return SpectralMotionLoss(TrainedVae(Waving(), plain, plain + 1), CENTRE, SCALE)  # type: ignore[arg-type]


def latent(size: float, phase: float = 0.0) -> torch.Tensor:
    return ((torch.tensor([[size, phase]]) - CENTRE) / SCALE)[None]


def test_a_prediction_is_denoised_as_ddim_does_it() -> None:
    generator = torch.Generator().manual_seed(0)
    true, noise, predicted = (torch.randn(3, 2, 4, generator=generator) for _ in range(3))
    alpha = torch.tensor([0.9, 0.5, 0.1])[:, None, None]
    noisy = alpha.sqrt() * true + (1 - alpha).sqrt() * noise
    expected = (noisy - (1 - alpha).sqrt() * predicted) / alpha.sqrt()
    torch.testing.assert_close(denoised(true, noise, predicted, alpha), expected)
    torch.testing.assert_close(denoised(true, noise, noise, alpha), true)


def test_how_far_a_hand_swings_counts_and_when_it_does_does_not() -> None:
    frames = torch.tensor([FRAMES])
    same, late, half = (swing()(made, latent(0.2), frames) for made in (latent(0.2), latent(0.2, 1.5), latent(0.1)))
    assert same.item() == pytest.approx(0.0, abs=1e-5) and late < 0.4 * half
    # A wave 0.1 m too small: bin 4 of 32 frames with its Hann neighbours of half its height, 0.2 m of one of 66
    # coordinates; of 16 frames bins 2 and 3, while bin 1 holds mostly where the hand is held.
    assert half.item() == pytest.approx((0.2 + 0.16) / 66, rel=0.03)


def test_it_pulls_towards_the_true_reach() -> None:
    for size, sign in ((0.1, -1), (0.3, 1)):
        made = latent(size).requires_grad_()
        swing()(made, latent(0.2), torch.tensor([FRAMES])).backward()
        assert made.grad is not None and made.grad[0, 0, 0].sign() == sign


def test_short_clips_and_padding_have_no_say() -> None:
    assert swing()(latent(0.1), latent(0.2), torch.tensor([12])).item() == 0.0
    both = torch.cat([latent(0.1), latent(0.1)]), torch.cat([latent(0.2), latent(0.2)])
    alone = swing()(latent(0.1), latent(0.2), torch.tensor([FRAMES]))
    torch.testing.assert_close(swing()(*both, torch.tensor([FRAMES, 40])), alone, rtol=0.02, atol=0)
