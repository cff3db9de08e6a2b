"""Batches of the diffusion stage: latents and caption graphs, with conditions dropped at random.

Every dropout teaches a model that works without what was dropped: without text (guidance), without the coarser latent
(compositions), without single nodes (edits). Shapes: b samples, n nodes, c latent tokens, z latent width.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Sampler

from kinegraph.bundle.contract import NULL_KIND, PADDING_BIAS
from kinegraph.conditioning import ACTION, MOTION, SPECIFIC, GraphArrays, as_partial, pad_graphs
from kinegraph.diffusion.composition import FIRST_CONCEPT, RowPlan
from kinegraph_training.composed_rows import (
    LATENT_AWARE,
    SEMANTIC_AWARE,
    ComposedRows,
    join_plans,
    plan_concepts,
)
from kinegraph_training.data.caption_cache import CaptionGraphs, CaptionStates
from kinegraph_training.data.clips import MotionClip, StoredClips
from kinegraph_training.dataset import Dataset
from kinegraph_training.latents import Latents
from kinegraph_training.models.hierarchy import GraphBatch
from kinegraph_training.synthetic.caption_grammar import draw_concepts

CONDITION_DROPOUT = 0.1
"""Share of samples with the null token in place of the graph, for classifier-free guidance (GraphMotion, Eq. A)."""
COARSE_DROPOUT_WITHOUT_TEXT = 0.5
"""Share of these that lose the coarser latent too: the paper's empty set. The rest are the base of compositions."""
COARSE_DROPOUT = 0.4
"""Share of samples with text that lose the coarser latent. A level that can always copy it learns to copy its mistakes:
after 2,500 steps, R@1 is 0.83 without this dropout, 0.92 with it, and 0.95 for a single level."""
MOTION_NODE_DROPOUT = 0.4
"""Share of samples whose motion node is hidden. It encodes the whole caption, so otherwise the model ignores edits of
single nodes and copies the nearest caption it knows for unseen pairs of style and action."""
ACTION_DROPOUT = 0.05
"""Share of actions that are hidden, with their arguments, where a caption has several."""
SPECIFIC_DROPOUT = 0.2
"""Share of specific nodes that are hidden."""
VERB_MASKING = 0.15
"""Share of samples whose verbs are masked in the text encoder, so that the rest steers too (GraphMotion, Table 6)."""
PARTIAL_CAPTIONS = 0.5
"""Share of the draws of a clip of several actions that take a caption of one of them, marked as partial."""
PARTIAL_WHOLE = 0.1
"""Share of all other draws that are marked as partial although they name everything: that is true of them as well."""
COARSE_NOISE = 0.6
"""Largest standard deviation of noise added to the coarser latent, which is exact in training and generated at run
time."""


ONE_ROW = plan_concepts(1, LATENT_AWARE)
"""Rows of a sample with one caption."""
POOL = 8
"""Batches that are drawn together and then sorted by length. Padding falls from a half to a tenth of the tokens: of
frames, and of captions too, whose graphs with words have 10 to 55 tokens."""


@dataclass(frozen=True)
class DenoiserBatch:
    """Batch of b samples, with a graphs: one for each, and more where samples are composed."""

    graph: GraphBatch
    """Of a graphs."""
    node_bias: Tensor
    """(a, n) additive attention bias: 0, or PADDING_BIAS for hidden nodes and padding."""
    latents: dict[str, Tensor]
    """Per level (b, c, z), standardised."""
    coarse: dict[str, Tensor]
    """Per level but the first: the latent of the level above, with noise."""
    coarse_bias: Tensor
    """(b,) 0, or PADDING_BIAS where the coarser latent is hidden."""
    frames: Tensor
    """(b,) length of the clip."""
    rows: ComposedRows | None = field(default=None, kw_only=True)
    """How the graphs make the samples; None is one for each."""

    def to(self, device: torch.device) -> DenoiserBatch:
        """Move all tensors to a device."""
        return DenoiserBatch(
            graph=GraphBatch(**{name: value.to(device) for name, value in vars(self.graph).items()}),
            node_bias=self.node_bias.to(device),
            latents={level: value.to(device) for level, value in self.latents.items()},
            coarse={level: value.to(device) for level, value in self.coarse.items()},
            coarse_bias=self.coarse_bias.to(device),
            frames=self.frames.to(device),
            rows=None if self.rows is None else self.rows.to(device),
        )

    def without_text(self) -> DenoiserBatch:
        """Put the null token in place of every graph."""
        bias = torch.full_like(self.node_bias, PADDING_BIAS)
        bias[:, 0] = 0.0
        graph = replace(self.graph, kind=torch.full_like(self.graph.kind, NULL_KIND))
        return replace(self, graph=graph, node_bias=bias)


def drop_nodes(graph: GraphArrays, rng: np.random.Generator) -> tuple[GraphArrays, np.ndarray]:
    """Drop the motion node, actions with their arguments, and specific nodes at random, as edits would.

    All edges of a dropped node get weight 0. This holds for the motion node too, as actions would otherwise tell of it.
    Words go with the node that they hang on.

    Returns:
        The graph, and (N,) True for the nodes that are left.
    """
    visible = np.ones(len(graph.kind), dtype=bool)
    # The token of a partial caption is not the sentence: it stays.
    visible[0] = graph.kind[0] != MOTION or rng.random() >= MOTION_NODE_DROPOUT
    visible[(graph.kind == SPECIFIC) & (rng.random(len(visible)) < SPECIFIC_DROPOUT)] = False
    actions = np.flatnonzero(graph.kind == ACTION)
    if len(actions) > 1:
        for action in actions[rng.random(len(actions)) < ACTION_DROPOUT]:
            visible[action] = False
            visible[(graph.relation[action] >= 0) & (graph.kind == SPECIFIC)] = False
    visible = visible[graph.owner]
    weight = graph.edge_weight * (visible[:, None] & visible[None, :] | np.eye(len(visible), dtype=bool))
    return replace(graph, edge_weight=weight.astype(np.float32)), visible


def null_graph(like: GraphArrays) -> GraphArrays:
    """Make a graph of the null token alone, which has no features, beside graphs like another one."""
    return GraphArrays(
        nodes=np.zeros((1, like.nodes.shape[1]), dtype=np.float32),
        relation=like.relation[:1, :1],
        edge_weight=np.ones((1, 1), dtype=np.float32),
        kind=np.array([NULL_KIND]),
        order=np.zeros(1, dtype=np.int64),
        path_weight=np.ones(1, dtype=np.float32),
        owner=np.zeros(1, dtype=np.int64),
    )


def pad_batch(graphs: Sequence[GraphArrays], visible: Sequence[np.ndarray]) -> tuple[GraphBatch, Tensor]:
    """Pad graphs to one size.

    Args:
        graphs: a of them.
        visible: (n,) of each, True for nodes that are not hidden.

    Returns:
        The graphs, and their attention bias (a, n).
    """
    arrays = {name: torch.from_numpy(value) for name, value in pad_graphs(graphs).items()}
    shape = arrays["node_mask"].shape
    kind, order = torch.zeros(shape, dtype=torch.int64), torch.zeros(shape, dtype=torch.int64)
    bias = torch.full(shape, PADDING_BIAS)
    # Padding must not have kind 0, that of the motion node.
    kind[arrays["node_mask"] == 0] = SPECIFIC
    for row, (graph, nodes) in enumerate(zip(graphs, visible, strict=True)):
        size = len(graph.kind)
        kind[row, :size] = torch.from_numpy(graph.kind)
        order[row, :size] = torch.from_numpy(graph.order)
        bias[row, :size] = torch.from_numpy(np.where(nodes, 0.0, PADDING_BIAS)).float()
    return GraphBatch(kind=kind, order=order, **arrays), bias


def is_splice(clip: MotionClip) -> bool:
    """Tell whether a clip was spliced of actions that its partial captions name one by one."""
    return clip.made_by.startswith("splices_") and bool(clip.partial_captions)


class DenoiserBatches:
    """Collate function: makes batches of clip indices, with dropout if `augment` is set.

    Args of the constructor: `graphs` of all captions, `masked` graphs of the same captions without their verbs, the
    seed of all random choices, and `composed`, the share of the draws of a splice by its partial captions that compose
    it of one for each action.

    Attributes:
        hiding: whether nodes are dropped and verbs masked. A model that must do without them from the start learns what
            they say later: with nothing hidden, 350 steps are worth what 500 are otherwise.
    """

    def __init__(
        self,
        dataset: Dataset,
        latents: dict[str, Latents],
        graphs: CaptionGraphs | CaptionStates,
        *,
        seed: int,
        augment: bool,
        masked: CaptionGraphs | None = None,
        composed: float = 0.0,
    ) -> None:
        self.dataset, self.latents, self.graphs, self.augment = dataset, latents, graphs, augment
        self.masked, self.composed = masked, composed
        self.hiding = augment
        self.seed = seed
        self.reseed(0)

    def reseed(self, offset: int) -> None:
        """Draw otherwise from here on; `offset` is another one for each process, and for each start of a run."""
        self.rng = np.random.Generator(np.random.PCG64(self.seed + offset))
        self.generator = torch.Generator().manual_seed(self.seed + offset)

    def __call__(self, indices: list[int]) -> DenoiserBatch:
        graph, bias, rows = self._draw_graphs(indices)
        clips = torch.tensor(indices)
        latents = {level: posterior.sample(clips, self.generator) for level, posterior in self.latents.items()}
        coarse = {level: self._add_noise(latents[above]) for above, level in pairwise(latents)}
        frames = torch.tensor([int(self.dataset.lengths[index]) for index in indices])
        batch = DenoiserBatch(graph, bias, latents, coarse, torch.zeros(len(indices)), frames, rows=rows)
        return self._drop_conditions(batch) if self.augment else batch

    def _draw_graphs(self, indices: list[int]) -> tuple[GraphBatch, Tensor, ComposedRows | None]:
        """Draw a caption for each clip, or captions that compose it.

        Returns:
            The padded graphs, their attention bias (a, n), and the rows of the samples if any is composed.
        """
        graphs: list[GraphArrays] = []
        visible: list[np.ndarray] = []
        plans: list[RowPlan] = []
        for index in indices:
            clip = self._clip(index)
            names_part = self.augment and bool(clip.partial_captions) and self.rng.random() < PARTIAL_CAPTIONS
            if names_part and is_splice(clip) and self.rng.random() < self.composed:
                plan, drawn = self._compose(clip)
            else:
                plan, drawn = ONE_ROW, [self._draw_shown(clip, names_part=names_part)]
            plans.append(plan)
            graphs += [graph for graph, _ in drawn]
            visible += [nodes for _, nodes in drawn]
        rows = join_plans(plans) if len(graphs) > len(indices) else None
        return (*pad_batch(graphs, visible), rows)

    def _draw_shown(self, clip: MotionClip, *, names_part: bool) -> tuple[GraphArrays, np.ndarray]:
        """Draw the graph of a caption, and (n,) True for its nodes that are not hidden."""
        graph = self._draw_caption(clip, names_part=names_part)
        if self.augment and self.hiding:
            return drop_nodes(graph, self.rng)
        return graph, np.ones(len(graph.kind), dtype=bool)

    def _compose(self, clip: MotionClip) -> tuple[RowPlan, list[tuple[GraphArrays, np.ndarray]]]:
        """Draw concepts that compose a clip, and the rows that do so: nothing of them is hidden."""
        concepts = [
            as_partial(self.graphs.get(caption))
            for caption in draw_concepts(clip.partial_captions, len(clip.actions), self.rng)
        ]
        plan = plan_concepts(len(concepts), SEMANTIC_AWARE if self.rng.random() < 0.5 else LATENT_AWARE)
        contexts = [null_graph(concepts[0])] * FIRST_CONCEPT + concepts
        graphs = [contexts[context] for context in plan.routing.context]
        return plan, [(graph, np.ones(len(graph.kind), dtype=bool)) for graph in graphs]

    def _clip(self, index: int) -> MotionClip:
        """Return a clip for its captions; the motion of one in shards is not read."""
        clips = self.dataset.clips
        return clips.without_motion(index) if isinstance(clips, StoredClips) else clips[index]

    def _draw_caption(self, clip: MotionClip, *, names_part: bool) -> GraphArrays:
        """Draw the graph of one of a clip's captions; without `augment` it is the first one."""
        if not self.augment:
            return self.graphs.get(clip.captions[0])
        captions = clip.partial_captions if names_part else clip.captions
        graph = self._draw_source().get(captions[int(self.rng.integers(len(captions)))])
        return as_partial(graph) if names_part or self.rng.random() < PARTIAL_WHOLE else graph

    def _draw_source(self) -> CaptionGraphs | CaptionStates:
        """Choose where a sample's graph comes from: in training, sometimes the graphs with masked verbs."""
        if self.augment and self.hiding and self.masked is not None and self.rng.random() < VERB_MASKING:
            return self.masked
        return self.graphs

    def _add_noise(self, latent: Tensor) -> Tensor:
        """Add noise of a random size to each coarser latent, in training only."""
        if not self.augment:
            return latent
        size = COARSE_NOISE * torch.rand(len(latent), 1, 1, generator=self.generator)
        return latent + size * torch.randn(latent.shape, generator=self.generator)

    def _drop_conditions(self, batch: DenoiserBatch) -> DenoiserBatch:
        """Replace some graphs by the null token, and hide some coarser latents."""
        count, rows = len(batch.frames), batch.rows
        null = torch.rand(count, generator=self.generator) < CONDITION_DROPOUT
        if rows is not None:
            null &= ~rows.composed
        dropout = torch.where(null, COARSE_DROPOUT_WITHOUT_TEXT, COARSE_DROPOUT)
        no_coarse = torch.rand(count, generator=self.generator) < dropout
        blank, of_graph = batch.without_text(), (null if rows is None else null[rows.attention_sample])[:, None]
        graph = replace(batch.graph, kind=torch.where(of_graph, blank.graph.kind, batch.graph.kind))
        bias = torch.where(of_graph, blank.node_bias, batch.node_bias)
        return replace(batch, graph=graph, node_bias=bias, coarse_bias=torch.where(no_coarse, PADDING_BIAS, 0.0))


def caption_sizes(clips: Iterable[MotionClip], graphs: CaptionGraphs | CaptionStates) -> NDArray[np.float64]:
    """Compute how many tokens the captions of each clip have in the mean, (n,)."""
    sizes = np.diff(graphs.offsets)
    return np.array([np.mean([sizes[graphs.captions[text]] for text in clip.captions]) for clip in clips])


class SimilarLengths(Sampler[list[int]]):
    """Sampler of batches of samples of similar length: a pool is drawn by weight, sorted, cut and shuffled.

    Lengths are those of what is padded: the clips in skeleton space, the captions of latent denoisers.
    """

    def __init__(self, lengths: NDArray[np.generic], weights: NDArray[np.float64], batch: int, batches: int) -> None:
        self.lengths, self.batch, self.batches = lengths, batch, batches
        self.weights = torch.from_numpy(weights).double()

    def __len__(self) -> int:
        return self.batches

    def __iter__(self) -> Iterator[list[int]]:
        done = 0
        while done < self.batches:
            count = min(POOL, self.batches - done)
            drawn = torch.multinomial(self.weights, count * self.batch, replacement=True).numpy()
            ordered = drawn[np.argsort(self.lengths[drawn], kind="stable")].reshape(count, self.batch)
            for index in torch.randperm(count).tolist():
                yield ordered[index].tolist()
            done += count
