"""The skeleton-space denoiser in training (EnergyMoGen, 3.1, appendix A and B; MDM, Tevet et al., 2023, Eq. 2 and 5).

Shapes: b samples, c groups of frames, g frames of a group, f features, z = g f.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import torch
from torch import Tensor

from kinegraph.bundle.contract import FRAMES, PADDING_BIAS
from kinegraph.errors import InvalidInputError
from kinegraph_training.config import FrameConfig, OptimiserConfig
from kinegraph_training.denoiser_batches import DenoiserBatch
from kinegraph_training.denoiser_module import DenoiserModule
from kinegraph_training.frame_batches import FrameBatch
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.frame_denoiser import hide_padding

ROOT_FEATURES = 4
"""Turn, two steps and height of the pelvis come first in every layout."""
ROOT_WEIGHT = 4.0
"""Weight of their squared error: of 137 features they are three in a hundred, and they alone say where a clip goes."""
VELOCITY_WEIGHT = 5.0
"""Weight of the error of steps from frame to frame. Without it frames that are right by themselves tremble: after 3,600
steps the third derivative of a walk was ten times that of the latent model."""
LENT = "specific"
"""Level of the latent denoisers that lends its weights to a new network."""
OWN_PARAMETERS = ("step.latent_in.", "step.noise_out.", "step.position", "context.coarse_")
"""Parameters that no latent denoiser can lend."""


def squared_error_of_frames(predicted: Tensor, clean: Tensor, token_mask: Tensor, features: int) -> Tensor:
    """Compute |x - x'|^2 of groups of frames (b, c, z), averaged over the tokens that are no padding: (b,)."""
    error = (predicted - clean).square().unflatten(-1, (-1, features))
    weight = error.new_ones(features)
    weight[:ROOT_FEATURES] = ROOT_WEIGHT
    per_token = (error * weight).mean(dim=(2, 3)) * (features / weight.sum())
    return (per_token * token_mask).sum(dim=1) / token_mask.sum(dim=1)


def squared_error_of_steps(predicted: Tensor, clean: Tensor, token_mask: Tensor, features: int) -> Tensor:
    """Compute the squared error of the steps from frame to frame, as MDM's Eq. 5: (b,).

    Both are groups of frames (b, c, z); steps into padding do not count.
    """
    error = (predicted - clean).unflatten(-1, (-1, features)).flatten(1, 2).diff(dim=1).square().mean(dim=2)
    group = predicted.shape[2] // features
    counts = token_mask.repeat_interleave(group, dim=1)[:, 1:]
    return (error * counts).sum(dim=1) / counts.sum(dim=1)


class FrameModule(DenoiserModule):
    """Skeleton-space denoiser with its loss, over the graph encoder of a bundle, which stays as it is.

    For comparison (`FrameConfig.from_latent`) both are trained together.
    """

    def __init__(
        self, config: DenoiserConfig, training: OptimiserConfig, latents: dict[str, LatentShape], frames: FrameConfig
    ) -> None:
        super().__init__(config, training, latents, {}, beta_end=frames.beta_end)
        self.save_hyperparameters({"frames": asdict(frames)})
        self.features = latents[FRAMES].width // frames.frames_per_token
        self.hierarchy.graph_encoder.requires_grad_(not frames.from_latent)

    def predict_clean(self, nodes: Tensor, batch: FrameBatch, timestep: Tensor, noise: Tensor) -> Tensor:
        """Mix noise into the frames, and predict them without; arguments as in `DenoiserModule.predict_noise`."""
        inputs = self.step_inputs(FRAMES, nodes, batch, timestep, noise)
        padding = hide_padding(batch.token_mask, PADDING_BIAS)
        predicted: Tensor = self.hierarchy.levels[FRAMES].step(*inputs, padding=padding)
        return predicted.float()

    def losses(self, batch: DenoiserBatch, generator: torch.Generator | None = None) -> dict[str, Tensor]:
        """Compute the squared error of the predicted clean frames and of their steps, (b,)."""
        assert isinstance(batch, FrameBatch)
        nodes, clean = self.hierarchy.encode(batch.graph), batch.latents[FRAMES]
        timestep = self.draw_timesteps(len(batch.frames), generator)
        noise = torch.randn(clean.shape, generator=generator).to(self.device)
        predicted = self.predict_clean(nodes, batch, timestep, noise)
        frames, steps = (
            error(predicted, clean, batch.token_mask, self.features)
            for error in (squared_error_of_frames, squared_error_of_steps)
        )
        return {FRAMES: frames + VELOCITY_WEIGHT * steps}

    def borrow_weights(self, state: Mapping[str, Any]) -> None:
        """Take the graph encoder of the latent denoisers, and what their finest one has of the same shape.

        Context encoder, modulation and layers start from what they learnt of words and motion.

        Args:
            state: `state_dict` of their checkpoint.

        Raises:
            InvalidInputError: it holds no graph encoder of this width.
        """
        own = self.hierarchy.state_dict()
        for name, value in own.items():
            short = name.removeprefix(f"levels.{FRAMES}.")
            lent = state.get(f"hierarchy.levels.{LENT}.{short}" if short != name else f"hierarchy.{name}")
            fits = lent is not None and lent.shape == value.shape and not short.startswith(OWN_PARAMETERS)
            if fits:
                own[name] = lent
            elif name.startswith("graph_encoder."):
                raise InvalidInputError(f"the latent denoisers have no {name} of shape {tuple(value.shape)}")
        self.hierarchy.load_state_dict(own)
