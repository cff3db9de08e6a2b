"""Batches for the diffusion stage: latents, caption graphs, and what is hidden from the model on purpose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from kinegraph.bundle.contract import NULL_KIND, PADDING_BIAS
from kinegraph.conditioning import ACTION, MOTION, SPECIFIC, GraphArrays, pad_graphs
from kinegraph_training.data.caption_cache import CaptionGraphs, CaptionStates
from kinegraph_training.dataset import Dataset
from kinegraph_training.latents import Latents
from kinegraph_training.models.hierarchy import GraphBatch

CONDITION_DROPOUT = 0.1
"""Share of samples with the null token in place of the graph (guidance, GraphMotion Eq. A)."""
NO_COARSE_GIVEN_NO_TEXT = 0.5
"""Half of those lose the coarser latent too: the paper's empty set, next to the base that compositions need."""
COARSE_DROPOUT = 0.4
"""Share of samples with text that do without the coarser latent: a level that may always copy it learns to copy its
mistakes too (R@1 after 2,500 steps: .83 copying, .92 so, .95 with a single level)."""
HIDE_MOTION = 0.4
"""The motion node holds the whole caption, edited words included: without this, edits would be ignored, and a turn of
a manner that was never seen turning would be what the whole sentence is nearest to."""
DROP_ACTION, DROP_SPECIFIC = 0.05, 0.2
MASK_VERBS = 0.15
"""Share of samples whose verbs the text encoder was not told: what is left must steer too (GraphMotion, Table 6)."""
COARSE_NOISE = 0.6
"""Largest noise added to the coarser latent, which is clean in training and generated at run time."""


@dataclass(frozen=True)
class DenoiserBatch:
    """b samples."""

    graph: GraphBatch
    node_bias: Tensor
    """(b, n) additive attention bias: 0, or PADDING_BIAS for hidden nodes and padding."""
    latents: dict[str, Tensor]
    """Per level (b, c, z), standardised."""
    coarse: dict[str, Tensor]
    """Per level but the first: the latent of the level above, with noise."""
    coarse_bias: Tensor
    """(b,) 0, or PADDING_BIAS where the coarser latent is hidden."""
    frames: Tensor
    """(b,) length of the clip."""

    def to(self, device: torch.device) -> DenoiserBatch:
        """All tensors on a device."""
        graph = GraphBatch(**{name: value.to(device) for name, value in vars(self.graph).items()})
        latents, coarse = ({k: v.to(device) for k, v in part.items()} for part in (self.latents, self.coarse))
        rest = (self.coarse_bias.to(device), self.frames.to(device))
        return DenoiserBatch(graph, self.node_bias.to(device), latents, coarse, *rest)

    def without_text(self) -> DenoiserBatch:
        """The null token in place of every graph."""
        bias = torch.full_like(self.node_bias, PADDING_BIAS)
        bias[:, 0] = 0.0
        graph = replace(self.graph, kind=torch.full_like(self.graph.kind, NULL_KIND))
        return replace(self, graph=graph, node_bias=bias)


def drop_nodes(graph: GraphArrays, rng: np.random.Generator) -> tuple[GraphArrays, np.ndarray]:
    """Drop some actions (with their arguments) and specifics the way an edit would: weight 0 on their edges, and on
    those of a hidden motion node, which the actions would else be told by.

    Returns the graph and (N,) True for nodes that are left.
    """
    kept = np.ones(len(graph.kind), dtype=bool)
    kept[MOTION] = rng.random() >= HIDE_MOTION
    kept[(graph.kind == SPECIFIC) & (rng.random(len(kept)) < DROP_SPECIFIC)] = False
    actions = np.flatnonzero(graph.kind == ACTION)
    if len(actions) > 1:
        for action in actions[rng.random(len(actions)) < DROP_ACTION]:
            kept[action] = False
            kept[(graph.relation[action] >= 0) & (graph.kind == SPECIFIC)] = False
    weight = graph.edge_weight * (kept[:, None] & kept[None, :] | np.eye(len(kept), dtype=bool))
    return replace(graph, edge_weight=weight.astype(np.float32)), kept


class DenoiserBatches:
    """Collates clip numbers into batches; `augment` is for training only, `masked` are the same captions' graphs with
    their verbs masked."""

    def __init__(
        self,
        dataset: Dataset,
        latents: dict[str, Latents],
        graphs: CaptionGraphs | CaptionStates,
        *,
        seed: int,
        augment: bool,
        masked: CaptionGraphs | None = None,
    ) -> None:
        self.dataset, self.latents, self.graphs, self.augment = dataset, latents, graphs, augment
        self.masked = masked
        self.rng = np.random.Generator(np.random.PCG64(seed))
        self.generator = torch.Generator().manual_seed(seed)

    def __call__(self, numbers: list[int]) -> DenoiserBatch:
        graph, bias = self._graphs(numbers)
        rows = torch.tensor(numbers)
        latents = {level: own.sample(rows, self.generator) for level, own in self.latents.items()}
        coarse = {level: self._noisy(latents[above]) for above, level in pairwise(latents)}
        frames = torch.tensor([len(self.dataset.features[number]) for number in numbers])
        batch = DenoiserBatch(graph, bias, latents, coarse, torch.zeros(len(numbers)), frames)
        return self._with_null_rows(batch) if self.augment else batch

    def _graphs(self, numbers: list[int]) -> tuple[GraphBatch, Tensor]:
        graphs, kept = [], []
        for number in numbers:
            captions = self.dataset.clips[number].captions
            chosen = int(self.rng.integers(len(captions))) if self.augment else 0
            graph = self._source().get(captions[chosen])
            left = np.ones(len(graph.kind), dtype=bool)
            if self.augment:
                graph, left = drop_nodes(graph, self.rng)
            graphs.append(graph)
            kept.append(left)
        arrays = {name: torch.from_numpy(value) for name, value in pad_graphs(graphs).items()}
        shape = arrays["node_mask"].shape
        kind, order = torch.zeros(shape, dtype=torch.int64), torch.zeros(shape, dtype=torch.int64)
        bias = torch.full(shape, PADDING_BIAS)
        # padding must not pass for a motion node
        kind[arrays["node_mask"] == 0] = SPECIFIC
        for row, (graph, left) in enumerate(zip(graphs, kept, strict=True)):
            size = len(graph.kind)
            kind[row, :size] = torch.from_numpy(graph.kind)
            order[row, :size] = torch.from_numpy(graph.order)
            bias[row, :size] = torch.from_numpy(np.where(left, 0.0, PADDING_BIAS)).float()
        return GraphBatch(kind=kind, order=order, **arrays), bias

    def _source(self) -> CaptionGraphs | CaptionStates:
        """Of one sample's graph: now and then the masked ones."""
        if self.augment and self.masked is not None and self.rng.random() < MASK_VERBS:
            return self.masked
        return self.graphs

    def _noisy(self, latent: Tensor) -> Tensor:
        if not self.augment:
            return latent
        size = COARSE_NOISE * torch.rand(len(latent), 1, 1, generator=self.generator)
        return latent + size * torch.randn(latent.shape, generator=self.generator)

    def _with_null_rows(self, batch: DenoiserBatch) -> DenoiserBatch:
        count = len(batch.frames)
        null = torch.rand(count, generator=self.generator) < CONDITION_DROPOUT
        hidden = torch.where(null, NO_COARSE_GIVEN_NO_TEXT, COARSE_DROPOUT)
        alone = torch.rand(count, generator=self.generator) < hidden
        blank = batch.without_text()
        graph = replace(batch.graph, kind=torch.where(null[:, None], blank.graph.kind, batch.graph.kind))
        bias = torch.where(null[:, None], blank.node_bias, batch.node_bias)
        return replace(batch, graph=graph, node_bias=bias, coarse_bias=torch.where(alone, PADDING_BIAS, 0.0))
