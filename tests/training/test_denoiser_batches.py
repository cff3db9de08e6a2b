"""What the denoisers are shown in training, and what is hidden from them on purpose."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from kinegraph.bundle.contract import LEVELS, NULL_KIND, PADDING_BIAS, PARTIAL_KIND
from kinegraph.conditioning import ACTION, MOTION, SPECIFIC, GraphArrays, with_words
from kinegraph_training import denoiser_batches
from kinegraph_training.config import OptimiserConfig
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.dataset import Dataset
from kinegraph_training.denoiser_batches import (
    COARSE_NOISE,
    PARTIAL_WHOLE,
    VERB_MASKING,
    DenoiserBatch,
    DenoiserBatches,
    drop_nodes,
)
from kinegraph_training.denoiser_module import DenoiserModule, HideLate, squared_error
from kinegraph_training.latents import Latents
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.graph_encoder import GraphEncoder

WIDTH = 12
SHAPES = {"motion": (2, 4), "action": (3, 4), "specific": (4, 4)}


def graph(parents: list[int], actions: int, seed: int = 0) -> GraphArrays:
    """A tree: node 0 the motion, `actions` actions below it, then a specific below each of `parents`."""
    count = 1 + actions + len(parents)
    relation = np.full((count, count), -1, dtype=np.int64)
    np.fill_diagonal(relation, 11)
    edges = [(0, action, 10) for action in range(1, actions + 1)]
    edges += [(parent, 1 + actions + index, index % 5) for index, parent in enumerate(parents)]
    for parent, child, kind in edges:
        relation[parent, child] = relation[child, parent] = kind
    return GraphArrays(
        nodes=np.random.default_rng(seed).standard_normal((count, WIDTH)).astype(np.float32),
        relation=relation,
        edge_weight=np.ones((count, count), dtype=np.float32),
        kind=np.array([MOTION] + [ACTION] * actions + [SPECIFIC] * len(parents), dtype=np.int64),
        order=np.array([0, *range(1, actions + 1), *parents], dtype=np.int64),
        path_weight=np.ones(count, dtype=np.float32),
        owner=np.arange(count),
    )


SMALL, LARGE = graph([1], 1), graph([1, 2, 2], 2, seed=1)


class Captions:
    """Two captions, without a parser."""

    def get(self, caption: str) -> GraphArrays:
        return {"small": SMALL, "large": LARGE}[caption]


class Masked:
    """The same two with other features, to be told apart by."""

    def get(self, caption: str) -> GraphArrays:
        arrays = Captions().get(caption)
        return replace(arrays, nodes=np.full_like(arrays.nodes, 7.0))


def batches(*, augment: bool, seed: int = 0, masked: object = None) -> DenoiserBatches:
    """Clip 0 has the small graph and 40 frames, clip 1 the large one and 60."""
    clips = [
        MotionClip(name, np.zeros((frames, 22, 3), dtype=np.float32), (name,), (), "")
        for name, frames in (("small", 40), ("large", 60))
    ]
    features = [np.zeros((len(clip.joints), 137), dtype=np.float32) for clip in clips]
    dataset = Dataset(clips, features, np.zeros(137, dtype=np.float32), np.ones(137, dtype=np.float32))
    generator = torch.Generator().manual_seed(9)
    # Posteriors without spread: what differs from the mean is noise that the batch added.
    latents = {
        level: Latents(torch.randn(2, *shape, generator=generator), torch.zeros(2, *shape), torch.zeros(shape),
                       torch.ones(shape))
        for level, shape in SHAPES.items()
    }  # fmt: skip
    graphs: Any = Captions()
    masked_graphs: Any = masked
    return DenoiserBatches(dataset, latents, graphs, seed=seed, augment=augment, masked=masked_graphs)


@pytest.fixture(scope="module")
def many() -> DenoiserBatch:
    return batches(augment=True)([0, 1] * 2000)


@pytest.fixture
def module() -> DenoiserModule:
    torch.manual_seed(2)
    config = DenoiserConfig(width=16, layers=3, heads=2, feed_forward=32, text_width=WIDTH, train_steps=50)
    training = OptimiserConfig(steps=1, learning_rate=1e-3, warmup=1, batch=2, ema=0.9)
    return DenoiserModule(config, training, {level: LatentShape(*shape) for level, shape in SHAPES.items()}, {}).eval()


def test_the_coarser_latent_is_noisy_in_training_and_the_target_is_not(many: DenoiserBatch) -> None:
    clean = batches(augment=False)([0, 1] * 2000)
    assert list(many.coarse) == ["action", "specific"]
    for above, level in (("motion", "action"), ("action", "specific")):
        torch.testing.assert_close(many.latents[level], clean.latents[level], atol=0, rtol=0)
        torch.testing.assert_close(clean.coarse[level], clean.latents[above], atol=0, rtol=0)
        # u n with u uniform in [0, s] and n normal has the variance s^2 / 3, and a kurtosis of its own: 27/5, not 3.
        added = (many.coarse[level] - many.latents[above]).flatten().double()
        assert float(added.mean().abs()) < 0.01
        assert float(added.square().mean()) == pytest.approx(COARSE_NOISE**2 / 3, rel=0.1)
        assert float(added.pow(4).mean() / added.square().mean() ** 2) == pytest.approx(5.4, rel=0.15)


def test_some_samples_have_their_verbs_masked_in_training_only() -> None:
    batch = batches(augment=True, masked=Masked())([0, 1] * 2000)
    without_verbs = (batch.graph.nodes[:, 0] == 7.0).all(dim=1)
    assert float(without_verbs.double().mean()) == pytest.approx(VERB_MASKING, abs=0.02)
    assert not (batches(augment=False, masked=Masked())([0, 1] * 20).graph.nodes == 7.0).any()


def test_a_tenth_loses_its_text_and_many_the_coarser_latent(many: DenoiserBatch) -> None:
    null = (many.graph.kind == NULL_KIND).all(dim=1)
    assert torch.equal(null, (many.graph.kind == NULL_KIND).any(dim=1))
    empty = many.coarse_bias == PADDING_BIAS
    assert float(null.double().mean()) == pytest.approx(0.10, abs=0.02)
    assert float(empty[null].double().mean()) == pytest.approx(0.5, abs=0.1)
    assert float(empty[~null].double().mean()) == pytest.approx(0.4, abs=0.04)
    assert (many.coarse_bias[~empty] == 0).all()
    # One null token, as at run time; more of them would weigh more against the coarser latent.
    assert (many.node_bias[null] == torch.tensor([0.0] + [PADDING_BIAS] * 5)).all()


def test_nodes_are_hidden_as_often_as_said(many: DenoiserBatch) -> None:
    large = (many.graph.kind != NULL_KIND).all(dim=1) & (torch.arange(4000) % 2 == 1)
    hidden = (many.node_bias[large] == PADDING_BIAS).double().mean(dim=0)
    # A specific is hidden by itself (0.2) or with its action (0.05); the token of a partial caption stays.
    expected = [0.4 * (1 - PARTIAL_WHOLE), 0.05, 0.05] + [1 - 0.8 * 0.95] * 3
    np.testing.assert_allclose(hidden.numpy(), expected, atol=0.045)
    small = (many.graph.kind != NULL_KIND).all(dim=1) & (torch.arange(4000) % 2 == 0)
    # The only action stays, and padding is never shown.
    assert (many.node_bias[small, 1] == 0).all() and (many.node_bias[small, 3:] == PADDING_BIAS).all()


def test_some_captions_are_told_to_name_a_part(many: DenoiserBatch) -> None:
    shown = (many.graph.kind != NULL_KIND).all(dim=1)
    part = many.graph.kind[shown, 0] == PARTIAL_KIND
    assert float(part.double().mean()) == pytest.approx(PARTIAL_WHOLE, abs=0.02)
    # Their token is always there, and nothing of the sentence reaches another node.
    assert (many.node_bias[shown][part, 0] == 0).all()
    edges = many.graph.relation[shown][part][:, 0, 1:] >= 0
    assert edges.any() and (many.graph.edge_weight[shown][part][:, 0, 1:][edges] == 0).all()


def test_words_go_with_the_node_that_they_hang_on() -> None:
    owners = np.array([0, 1, 3, 3, 5])
    words = with_words(LARGE, np.ones((5, WIDTH), dtype=np.float32), owners)
    for seed in range(20):
        _, visible = drop_nodes(words, np.random.default_rng(seed))
        np.testing.assert_array_equal(visible[6:], visible[owners])


def test_validation_hides_nothing() -> None:
    batch = batches(augment=False)([0, 1])
    assert torch.equal(batch.node_bias == 0, batch.graph.node_mask == 1)
    assert (batch.graph.edge_weight == 1).all() and (batch.coarse_bias == 0).all()
    assert batch.frames.tolist() == [40, 60]


@pytest.mark.parametrize("seed", range(6))
def test_a_dropped_node_is_a_node_that_is_not_there(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(denoiser_batches, "ACTION_DROPOUT", 0.5)
    monkeypatch.setattr(denoiser_batches, "SPECIFIC_DROPOUT", 0.4)
    torch.manual_seed(0)
    encoder = GraphEncoder(WIDTH)
    dropped, visible = drop_nodes(LARGE, np.random.default_rng(seed))
    left = np.flatnonzero(visible)
    # Specifics 3 | 4, 5 hang below actions 1 | 2 and never outlive them.
    assert not (visible[3] and not visible[1]) and not ((visible[4] or visible[5]) and not visible[2])
    np.testing.assert_array_equal(dropped.order, LARGE.order)
    with torch.no_grad():
        arrays = (dropped.nodes, dropped.relation, dropped.edge_weight)
        whole = encoder(*(torch.from_numpy(part)[None] for part in arrays), torch.ones(1, 6))
        cut = (LARGE.nodes[left], LARGE.relation[np.ix_(left, left)], LARGE.edge_weight[np.ix_(left, left)])
        alone = encoder(*(torch.from_numpy(part)[None] for part in cut), torch.ones(1, len(left)))
    torch.testing.assert_close(whole[:, left], alone, atol=1e-6, rtol=0)


def test_some_seed_drops_something(monkeypatch: pytest.MonkeyPatch) -> None:
    # Or the test above would say nothing.
    monkeypatch.setattr(denoiser_batches, "ACTION_DROPOUT", 0.5)
    kept = [drop_nodes(LARGE, np.random.default_rng(seed))[1] for seed in range(6)]
    assert len({int(nodes[1:].sum()) for nodes in kept}) > 1
    assert {bool(nodes[0]) for nodes in kept} == {True, False}


def level_loss(module: DenoiserModule, level: str, nodes: torch.Tensor, batch: DenoiserBatch, timestep: torch.Tensor,
               noise: torch.Tensor) -> torch.Tensor:  # fmt: skip
    """Mean squared error of one level's prediction: (b,)."""
    return squared_error(module.predict_noise(level, nodes, batch, timestep, noise), noise)


def influence(module: DenoiserModule, level: str, batch: DenoiserBatch) -> tuple[torch.Tensor, torch.Tensor | None]:
    """Which nodes (b, n), and which rows' coarser latents (b,), the loss of one level depends on."""
    count = len(batch.frames)
    nodes = module.hierarchy.encode(batch.graph).detach().requires_grad_()
    coarse = {name: value.clone().requires_grad_() for name, value in batch.coarse.items()}
    noise = torch.randn(batch.latents[level].shape, generator=torch.Generator().manual_seed(1))
    loss = level_loss(module, level, nodes, replace(batch, coarse=coarse), torch.full((count,), 20), noise)
    loss.sum().backward()
    above = coarse[level].grad.abs().sum(dim=(1, 2)) > 0 if level in coarse else None
    return nodes.grad.abs().sum(dim=-1) > 0, above


@pytest.mark.parametrize(("level", "kinds"), [("motion", 1), ("action", 2), ("specific", 3)])
def test_a_level_looks_at_its_nodes_and_at_the_level_above(module: DenoiserModule, level: str, kinds: int) -> None:
    batch = batches(augment=False)([0, 1])
    nodes, coarse = influence(module, level, batch)
    assert torch.equal(nodes, (batch.graph.kind < kinds) & (batch.graph.node_mask == 1))
    assert (coarse is None) if level == "motion" else coarse.all()


@pytest.mark.parametrize("level", LEVELS)
def test_without_text_only_the_coarser_latent_is_seen_and_it_can_be_hidden(module: DenoiserModule, level: str) -> None:
    blank = batches(augment=False)([0, 1]).without_text()
    blank = replace(blank, coarse_bias=torch.tensor([0.0, PADDING_BIAS]))
    nodes, coarse = influence(module, level, blank)
    assert not nodes.any()
    assert (coarse is None) if level == "motion" else coarse.tolist() == [True, False]


def test_a_hidden_sentence_is_hidden_from_all_who_see_something_else(module: DenoiserModule) -> None:
    batch = batches(augment=False)([0, 1])
    batch.node_bias[:, 0] = PADDING_BIAS
    seen = {level: influence(module, level, batch)[0] for level in LEVELS}
    assert not seen["action"][:, 0].any() and not seen["specific"][:, 0].any()
    # And nothing but the sentence: were all hidden alike, attention would be even over all, padding included.
    assert torch.equal(seen["motion"], batch.graph.kind == MOTION)


@pytest.mark.parametrize("level", LEVELS)
def test_a_sample_does_not_know_its_neighbours(module: DenoiserModule, level: str) -> None:
    # The small graph is padded to six nodes next to the large one.
    both, alone = batches(augment=False)([0, 1]), batches(augment=False)([0])
    noise = torch.randn(2, *SHAPES[level], generator=torch.Generator().manual_seed(4))
    with torch.no_grad():
        first = level_loss(module, level, module.hierarchy.encode(both.graph), both, torch.tensor([30, 5]), noise)
        expected = level_loss(module, level, module.hierarchy.encode(alone.graph), alone, torch.tensor([30]), noise[:1])
    torch.testing.assert_close(first[:1], expected, atol=1e-6, rtol=0)


def test_the_loss_is_that_of_the_noise_in_a_noised_latent(
    module: DenoiserModule, monkeypatch: pytest.MonkeyPatch
) -> None:
    batch = batches(augment=False)([0, 1])
    noise = torch.randn(2, *SHAPES["action"], generator=torch.Generator().manual_seed(4))
    read = []
    step = module.hierarchy.levels["action"].step
    monkeypatch.setattr(step, "forward", lambda latent, *_: read.append(latent) or torch.zeros_like(latent))
    nodes = module.hierarchy.encode(batch.graph)
    loss = level_loss(module, "action", nodes, batch, torch.tensor([0, 49]), noise)
    np.testing.assert_allclose(loss.detach(), noise.square().mean(dim=(1, 2)), rtol=1e-5)
    betas = np.linspace(np.sqrt(8.5e-4), np.sqrt(0.012), 50) ** 2
    alpha = np.cumprod(1 - betas)[[0, 49], None, None]
    expected = np.sqrt(alpha) * batch.latents["action"].numpy() + np.sqrt(1 - alpha) * noise.numpy()
    np.testing.assert_allclose(read[0], expected, atol=1e-5)


def test_nothing_is_hidden_before_the_last_part_of_a_run() -> None:
    early = batches(augment=True, masked=Masked())
    early.hiding = False
    batch = early([0, 1] * 500)
    has_text = (batch.graph.kind != NULL_KIND).any(dim=1)
    padding = batch.graph.node_mask == 0
    assert ((batch.node_bias == PADDING_BIAS) == padding)[has_text].all()
    assert not (batch.graph.nodes == 7.0).any()
    callback = HideLate(early, first_step=3)
    for step, hides in ((2, False), (3, True)):
        callback.on_train_batch_start(SimpleNamespace(global_step=step), None, None, 0)
        assert early.hiding is hides


def test_half_of_the_draws_of_a_composition_name_a_part_and_say_so() -> None:
    composed = batches(augment=True)
    composed.hiding = False
    composed.dataset.clips[0] = replace(composed.dataset.clips[0], partial_captions=("large",))
    batch = composed([0] * 2000)
    text = (batch.graph.kind != NULL_KIND).any(dim=1)
    is_large = batch.graph.node_mask.sum(dim=1) == len(LARGE.kind)
    is_partial = batch.graph.kind[:, 0] == PARTIAL_KIND
    assert float(is_large.double().mean()) == pytest.approx(0.5, abs=0.04)
    assert is_partial[is_large & text].all()
    # Some that name everything are marked as well.
    assert float(is_partial[~is_large & text].double().mean()) == pytest.approx(PARTIAL_WHOLE, abs=0.03)
