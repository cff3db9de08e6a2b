"""Sample the whole pipeline in torch, from node features to joints, as the reference that the runtime is compared with.

It shares neither schedule nor loop nor batching with the runtime's sampler; noise and graphs are the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import NULL_KIND, PADDING_BIAS
from kinegraph.conditioning import GraphArrays
from kinegraph.motion.features import joints_from_features
from kinegraph_export.graphs import TrainedModels
from kinegraph_training.models.agd import AgdNoisePredictor
from kinegraph_training.models.denoiser import ContextTokens, Denoiser
from kinegraph_training.models.hierarchy import GraphBatch


@dataclass(frozen=True)
class SamplingRequest:
    """Length, noise and options of one clip."""

    frames: int
    noise: tuple[FloatArray, ...]
    """(c, z) of each level."""
    steps: Mapping[str, int]
    guidance: Mapping[str, float]
    guidance_base: str
    """"empty" or "coarse", as in `kinegraph.bundle.manifest.Defaults`."""
    agd: tuple[float, float] | None = None
    """Step sizes gamma_attn and gamma_reg (EnergyMoGen, Eq. 3, 4) for the text."""


def alpha_bar(train_steps: int = 1000) -> Tensor:
    """Compute alpha-bar (train_steps,) of the scaled-linear schedule from its definition."""
    return torch.cumprod(1 - torch.linspace(0.00085**0.5, 0.012**0.5, train_steps, dtype=torch.float64) ** 2, dim=0)


Condition = tuple[list[tuple[Tensor, Tensor]], Tensor]
"""Keys and values of each layer, and the attention bias (1, n) of the nodes."""


def level_conditions(
    denoiser: Denoiser, graph: GraphArrays, nodes: Tensor, kinds: int, coarse: Tensor | None
) -> tuple[dict[str, Condition], Tensor]:
    """Encode the nodes that a level sees, and the empty condition of guidance.

    Args:
        denoiser: of the level.
        graph: kinds, order and weights of the nodes.
        nodes: (n, d) encoded nodes.
        kinds: node kinds that the level sees.
        coarse: (1, c, z) final latent of the level above; None at the first.

    Returns:
        Conditions "text" and "null", and the tokens (1, n, d) that adaptive gradient descent moves.
    """
    visible = torch.from_numpy(graph.kind < kinds)
    kind, order = torch.from_numpy(graph.kind)[visible][None], torch.from_numpy(graph.order)[visible][None]
    seen = nodes[visible][None]
    bias = torch.log(torch.from_numpy(graph.path_weight)[visible][None]).clamp(min=PADDING_BIAS)
    null_kind = torch.full((1, 1), NULL_KIND)
    empty = denoiser.context(torch.zeros(1, 1, nodes.shape[-1]), null_kind, torch.zeros_like(null_kind), coarse)
    conditions = {"text": (denoiser.context(seen, kind, order, coarse), bias), "null": (empty, torch.zeros(1, 1))}
    return conditions, ContextTokens.forward(denoiser.context, seen, kind, order, coarse)


def sample_level(
    trained: TrainedModels,
    level: str,
    graph: GraphArrays,
    nodes: Tensor,
    coarse: Tensor | None,
    request: SamplingRequest,
) -> Tensor:
    """Sample the latent (1, c, z) of one level by guided DDIM, one noise prediction at a time.

    Args:
        trained: the models.
        level: name of the level.
        graph: kinds, order and weights of the nodes.
        nodes: (n, d) encoded nodes.
        coarse: (1, c, z) final latent of the level above; None at the first.
        request: length, noise and options.
    """
    denoiser, config = trained.hierarchy.levels[level], trained.hierarchy.config
    conditions, tokens = level_conditions(denoiser, graph, nodes, config.kinds_seen(level), coarse)
    coarse_tokens = 0 if coarse is None else coarse.shape[1]
    latent = torch.from_numpy(request.noise[config.levels.index(level)])[None]
    alphas, stride = alpha_bar(), 1000 // request.steps[level]
    for index in reversed(range(request.steps[level])):
        time = index * stride + 1
        clock = denoiser.clock(torch.tensor([time]), torch.tensor([request.frames]))
        noise = {}
        for name, (context, bias) in conditions.items():
            hide_coarse = name == "null" and request.guidance_base == "empty"
            coarse_bias = torch.full((1, coarse_tokens), PADDING_BIAS if hide_coarse else 0.0)
            full_bias = torch.cat([bias, coarse_bias], dim=1)[:, None, None, :]
            if name == "text" and request.agd is not None:
                gamma = torch.tensor([request.agd])
                noise[name] = AgdNoisePredictor(denoiser)(latent, clock, tokens, gamma, full_bias)
            else:
                noise[name] = denoiser.step(latent, clock, context, full_bias)
        guided = noise["null"] + request.guidance[level] * (noise["text"] - noise["null"])
        # DDIM, Eq. 12 with eta = 0: z_0 from z_t and eps, then z_{t-1} from z_0 and eps
        now, after = alphas[time], alphas[max(time - stride, 0)]
        clean = (latent - (1 - now).sqrt() * guided) / now.sqrt()
        latent = (after.sqrt() * clean + (1 - after).sqrt() * guided).float()
    return latent


@torch.no_grad()
def torch_joints(
    trained: TrainedModels, graph: GraphArrays, request: SamplingRequest, mean: FloatArray, std: FloatArray
) -> FloatArray:
    """Sample joints (frames, 22, 3), metres, of one graph.

    Args:
        trained: the models.
        graph: with the features of its nodes.
        request: length, noise and options.
        mean: (features,) of the specific level's features.
        std: (features,) of the same.
    """
    inputs = {name: getattr(graph, name) for name in ("nodes", "relation", "edge_weight", "kind", "order")}
    inputs["node_mask"] = np.ones(len(graph.kind), dtype=np.float32)
    nodes = trained.hierarchy.encode(GraphBatch(**{k: torch.from_numpy(v)[None] for k, v in inputs.items()}))[0]
    latent: Tensor | None = None
    for level in trained.hierarchy.latents:
        latent = sample_level(trained, level, graph, nodes, latent, request)
    group = trained.vae.config.frames_per_token
    mask = torch.zeros(1, -(-request.frames // group) * group)
    mask[:, : request.frames] = 1.0
    assert latent is not None
    features = trained.vae.decode(latent * trained.scale + trained.centre, mask)[0, : request.frames].numpy()
    return joints_from_features(features * std + mean)
