"""The whole pipeline in torch, from node features to joints, to hold the runtime against (same noise, same graphs).

Written without the runtime's sampler: its own schedule, loop and batching.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import NULL_KIND
from kinegraph.conditioning import GraphArrays
from kinegraph.motion.features import joints_from_features
from kinegraph_export.graphs import Trained
from kinegraph_training.models.agd import AgdNoisePredictor
from kinegraph_training.models.denoiser import ContextTokens
from kinegraph_training.models.hierarchy import GraphBatch
from kinegraph_training.models.transformer import MASKED


@dataclass(frozen=True)
class Request:
    """What is sampled."""

    frames: int
    noise: tuple[FloatArray, ...]
    """(c, z) per level."""
    steps: Mapping[str, int]
    guidance: Mapping[str, float]
    guidance_base: str
    """As in `kinegraph.bundle.manifest.Defaults`."""
    agd: tuple[float, float] | None = None
    """Step sizes gamma_attn and gamma_reg (EnergyMoGen, Eq. 3, 4) for the text."""


def alpha_bar(train_steps: int = 1000) -> Tensor:
    """The schedule, straight from its definition."""
    return torch.cumprod(1 - torch.linspace(0.00085**0.5, 0.012**0.5, train_steps, dtype=torch.float64) ** 2, dim=0)


def level_latent(
    trained: Trained, level: str, graph: GraphArrays, nodes: Tensor, coarse: Tensor | None, request: Request
) -> Tensor:
    """Guided DDIM of one level, one prediction at a time."""
    denoiser = trained.hierarchy.levels[level]
    config = trained.hierarchy.config
    number = config.levels.index(level)
    visible = torch.from_numpy(graph.kind < config.kinds_seen(level))
    kind, order = torch.from_numpy(graph.kind)[visible][None], torch.from_numpy(graph.order)[visible][None]
    weights = torch.from_numpy(graph.path_weight)[visible][None]
    null_kind = torch.full((1, 1), NULL_KIND)
    cases = {
        "text": (denoiser.context(nodes[visible][None], kind, order, coarse), torch.log(weights).clamp(min=MASKED)),
        "null": (
            denoiser.context(torch.zeros(1, 1, nodes.shape[-1]), null_kind, torch.zeros_like(null_kind), coarse),
            torch.zeros(1, 1),
        ),
    }
    tokens = ContextTokens.forward(denoiser.context, nodes[visible][None], kind, order, coarse)
    extra = 0 if coarse is None else coarse.shape[1]
    latent = torch.from_numpy(request.noise[number])[None]
    table, stride = alpha_bar(), 1000 // request.steps[level]
    for index in reversed(range(request.steps[level])):
        time = index * stride + 1
        clock = denoiser.clock(torch.tensor([time]), torch.tensor([request.frames]))
        noise = {}
        for name, (context, bias) in cases.items():
            hidden = torch.full((1, extra), MASKED if name == "null" and request.guidance_base == "empty" else 0.0)
            full = torch.cat([bias, hidden], dim=1)[:, None, None, :]
            if name == "text" and request.agd is not None:
                gamma = torch.tensor([request.agd])
                noise[name] = AgdNoisePredictor(denoiser)(latent, clock, tokens, gamma, full)
            else:
                noise[name] = denoiser.step(latent, clock, context, full)
        guided = noise["null"] + request.guidance[level] * (noise["text"] - noise["null"])
        now, after = table[time], table[max(time - stride, 0)]
        clean = (latent - (1 - now).sqrt() * guided) / now.sqrt()
        latent = (after.sqrt() * clean + (1 - after).sqrt() * guided).float()
    return latent


@torch.no_grad()
def torch_joints(
    trained: Trained, graph: GraphArrays, request: Request, mean: FloatArray, std: FloatArray
) -> FloatArray:
    """Joints (frames, 22, 3)."""
    inputs = {name: getattr(graph, name) for name in ("nodes", "relation", "edge_weight", "kind", "order")}
    inputs["node_mask"] = np.ones(len(graph.kind), dtype=np.float32)
    nodes = trained.hierarchy.encode(GraphBatch(**{k: torch.from_numpy(v)[None] for k, v in inputs.items()}))[0]
    latent: Tensor | None = None
    for level in trained.hierarchy.latents:
        latent = level_latent(trained, level, graph, nodes, latent, request)
    group = trained.vae.config.frames_per_token
    mask = torch.zeros(1, -(-request.frames // group) * group)
    mask[:, : request.frames] = 1.0
    assert latent is not None
    features = trained.vae.decode(latent * trained.scale + trained.centre, mask)[0, : request.frames].numpy()
    return joints_from_features(features * std + mean)
