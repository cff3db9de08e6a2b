"""Sample the whole pipeline in torch, from node features to joints, as the reference that the runtime is compared with.

It shares neither schedule nor loop nor batching with the runtime's sampler; noise and graphs are the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import KINDS, PADDING_BIAS
from kinegraph.conditioning import GraphArrays
from kinegraph_export.graphs import TrainedModels
from kinegraph_training.layouts import layout_of
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
    spacing: str = "leading"
    """Of the steps: "leading" or "trailing", as in `kinegraph.bundle.manifest.ScheduleSpec`."""

    def times(self, level: str) -> list[int]:
        """List the timesteps of a level, the noisiest first."""
        count = self.steps[level]
        if self.spacing == "trailing":
            return [round(1000 - index * 1000 / count) - 1 for index in range(count)]
        return [index * (1000 // count) + 1 for index in reversed(range(count))]


def alpha_bar(train_steps: int = 1000, beta_end: float = 0.012) -> Tensor:
    """Compute alpha-bar (train_steps,) of the scaled-linear schedule from its definition."""
    return torch.cumprod(1 - torch.linspace(0.00085**0.5, beta_end**0.5, train_steps, dtype=torch.float64) ** 2, dim=0)


@dataclass(frozen=True)
class LevelConditions:
    """Context tokens of one prediction, n nodes and words and s in all."""

    context: list[tuple[Tensor, Tensor]]
    """Keys and values of each layer."""
    tokens: Tensor
    """(1, s, d) that they are projected from, which adaptive gradient descent moves."""
    bias: Tensor
    """(1, s) log weight of each token."""


def level_conditions(
    denoiser: Denoiser, graph: GraphArrays, nodes: Tensor, kinds: Sequence[str], coarse: Tensor | None, *, empty: bool
) -> dict[str, LevelConditions]:
    """Encode what a level sees, "text", and the condition that guidance leads away from, "null".

    Args:
        denoiser: of the level.
        graph: kinds, order and weights of the nodes.
        nodes: (n, d) encoded nodes.
        kinds: names of the kinds that the level sees.
        coarse: (1, c, z) final latent of the level above; None at the first.
        empty: whether "null" does not see the coarser latent either.
    """
    visible = torch.from_numpy(np.isin(graph.kind, [KINDS[name] for name in (*kinds, "partial")]))
    kind, order = torch.from_numpy(graph.kind)[visible][None], torch.from_numpy(graph.order)[visible][None]
    bias = torch.log(torch.from_numpy(graph.path_weight)[visible][None]).clamp(min=PADDING_BIAS)
    blank = torch.zeros(1, 1, nodes.shape[-1])
    null_kind = torch.full((1, 1), KINDS["null"])
    coarse_tokens = 0 if coarse is None else coarse.shape[1]

    def encode(seen: Tensor, kind: Tensor, order: Tensor, node_bias: Tensor, coarse_bias: float) -> LevelConditions:
        full = torch.cat([node_bias, torch.full((1, coarse_tokens), coarse_bias)], dim=1)
        inputs = (seen, kind, order, full, coarse)
        return LevelConditions(denoiser.context(*inputs), ContextTokens.forward(denoiser.context, *inputs), full)

    return {
        "text": encode(nodes[visible][None], kind, order, bias, 0.0),
        "null": encode(
            blank, null_kind, torch.zeros_like(null_kind), torch.zeros(1, 1), PADDING_BIAS if empty else 0.0
        ),
    }


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
    empty = request.guidance_base == "empty"
    conditions = level_conditions(denoiser, graph, nodes, config.kinds_seen(level), coarse, empty=empty)
    latent = torch.from_numpy(request.noise[config.levels.index(level)])[None]
    alphas, stride = alpha_bar(), 1000 // request.steps[level]
    for time in request.times(level):
        clock = denoiser.clock(torch.tensor([time]), torch.tensor([request.frames]))
        noise = {}
        for name, condition in conditions.items():
            bias = condition.bias[:, None, None, :]
            if name == "text" and request.agd is not None:
                gamma = torch.tensor([request.agd])
                noise[name] = AgdNoisePredictor(denoiser)(latent, clock, condition.tokens, gamma, bias)
            else:
                noise[name] = denoiser.step(latent, clock, condition.context, bias)
        guided = noise["null"] + request.guidance[level] * (noise["text"] - noise["null"])
        # DDIM, Eq. 12 with eta = 0: z_0 from z_t and eps, then z_{t-1} from z_0 and eps
        now, after = alphas[time], alphas[max(time - stride, 0)]
        clean = (latent - (1 - now).sqrt() * guided) / now.sqrt()
        latent = (after.sqrt() * clean + (1 - after).sqrt() * guided).float()
    return latent


def as_batch(graph: GraphArrays) -> GraphBatch:
    """Make a batch of one graph."""
    inputs = {name: getattr(graph, name) for name in ("nodes", "relation", "edge_weight", "kind", "order")}
    inputs["node_mask"] = np.ones(len(graph.kind), dtype=np.float32)
    return GraphBatch(**{name: torch.from_numpy(value)[None] for name, value in inputs.items()})


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
    nodes = trained.hierarchy.encode(as_batch(graph))[0]
    latent: Tensor | None = None
    for level in trained.hierarchy.latents:
        latent = sample_level(trained, level, graph, nodes, latent, request)
    group = trained.vae.config.frames_per_token
    mask = torch.zeros(1, -(-request.frames // group) * group)
    mask[:, : request.frames] = 1.0
    assert latent is not None
    features = trained.vae.decode(latent * trained.scale + trained.centre, mask)[0, : request.frames].numpy()
    return layout_of(len(mean)).to_joints(features * std + mean)
