"""Samples that are composed of several captions in training, against the sums of EnergyMoGen's Eq. 7 and 9 by hand."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from kinegraph.bundle.contract import LEVELS, NULL_KIND, PADDING_BIAS, PARTIAL_KIND
from kinegraph.conditioning import ACTION, MOTION, GraphArrays, as_partial
from kinegraph_training.composed_rows import LATENT_AWARE, SEMANTIC_AWARE, join_plans, plan_concepts
from kinegraph_training.config import OptimiserConfig
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.dataset import Dataset
from kinegraph_training.denoiser_batches import (
    PARTIAL_CAPTIONS,
    DenoiserBatch,
    DenoiserBatches,
    null_graph,
    pad_batch,
)
from kinegraph_training.denoiser_module import DenoiserModule
from kinegraph_training.latents import Latents
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.synthetic.caption_grammar import draw_concepts, partial_captions

WIDTH = 12
SHAPES = {"motion": (2, 4), "action": (3, 4), "specific": (4, 4)}
TWO = ("walks", "strolls", "waves", "beckons")
THREE = ("walks", "waves", "nods", "waves and nods", "walks and nods", "walks and waves")
RNG = np.random.default_rng(3)


def graph(caption: str) -> GraphArrays:
    """A sentence with one action; its features tell the captions apart."""
    relation = np.array([[11, 10], [10, 11]])
    nodes = np.random.default_rng(sum(map(ord, caption))).standard_normal((2, WIDTH)).astype(np.float32)
    return GraphArrays(nodes, relation, np.ones((2, 2), np.float32), np.array([MOTION, ACTION]), np.array([0, 1]),
                       np.ones(2, np.float32), np.arange(2))  # fmt: skip


class Captions:
    def get(self, caption: str) -> GraphArrays:
        return graph(caption)


def batches(composed: float, *, augment: bool = True) -> DenoiserBatches:
    """Clip 0 is recorded, clips 1 and 2 are spliced of two and three actions."""
    clips = [
        MotionClip("recorded", np.zeros((40, 22, 3), np.float32), ("runs",), ("run",), ""),
        MotionClip("two", np.zeros((60, 22, 3), np.float32), ("walks and waves",), ("walk", "wave"), "",
                   partial_captions=TWO, made_by="splices_2"),
        MotionClip("three", np.zeros((60, 22, 3), np.float32), ("all",), ("walk", "wave", "nod"), "",
                   partial_captions=THREE, made_by="splices_3"),
    ]  # fmt: skip
    features = [np.zeros((len(clip.joints), 137), np.float32) for clip in clips]
    dataset = Dataset(clips, features, np.zeros(137, np.float32), np.ones(137, np.float32))
    generator = torch.Generator().manual_seed(9)
    latents = {
        level: Latents(torch.randn(3, *shape, generator=generator), torch.zeros(3, *shape), torch.zeros(shape),
                       torch.ones(shape))
        for level, shape in SHAPES.items()
    }  # fmt: skip
    graphs: Any = Captions()
    return DenoiserBatches(dataset, latents, graphs, seed=1, augment=augment, composed=composed)


@pytest.fixture(scope="module")
def module() -> DenoiserModule:
    torch.manual_seed(2)
    config = DenoiserConfig(
        width=16,
        layers=3,
        heads=2,
        feed_forward=32,
        text_width=WIDTH,
        train_steps=50,
        context_layers=1,
        nodes_seen="all",
    )
    training = OptimiserConfig(steps=1, learning_rate=1e-3, warmup=1, batch=2, ema=0.9)
    shapes = {level: LatentShape(*shape) for level, shape in SHAPES.items()}
    made = DenoiserModule(config, training, shapes, {}).eval()
    for parameter in made.parameters():  # layers that begin at zero would let everything agree
        torch.nn.init.normal_(parameter, std=0.6)
    return made


def predict(module: DenoiserModule, level: str, captions: list[GraphArrays], coarse_bias: float = 0.0) -> torch.Tensor:
    """Predictions (n, c, z) for one latent and each of n captions, one sample each."""
    count = len(captions)
    generator = torch.Generator().manual_seed(5)
    latents = {name: torch.randn(1, *shape, generator=generator).repeat(count, 1, 1) for name, shape in SHAPES.items()}
    noise = torch.randn(1, *SHAPES[level], generator=generator).repeat(count, 1, 1)
    graphs, bias = pad_batch(captions, [np.arange(len(each.kind)) < (1 if each.kind[0] == NULL_KIND else 99)
                                        for each in captions])  # fmt: skip
    coarse = {"action": latents["motion"], "specific": latents["action"]}
    batch = DenoiserBatch(graphs, bias, latents, coarse, torch.full((count,), coarse_bias), torch.full((count,), 60))
    with torch.no_grad():
        return module.predict_noise(level, module.hierarchy.encode(graphs), batch, torch.full((count,), 20), noise)


def predict_composed(
    module: DenoiserModule, level: str, concepts: list[str], lambdas: tuple[float, float, float]
) -> torch.Tensor:
    """Predictions (3, c, z) of a plain sample, a composed one and a plain one, of the same latent and noise."""
    plans = [plan_concepts(1, lambdas), plan_concepts(len(concepts), lambdas), plan_concepts(1, lambdas)]
    partial = [as_partial(graph(concept)) for concept in concepts]
    contexts = [null_graph(partial[0]), null_graph(partial[0]), *partial]
    captions = [graph("runs"), *(contexts[index] for index in plans[1].routing.context), graph("sits")]
    generator = torch.Generator().manual_seed(5)
    latents = {name: torch.randn(1, *shape, generator=generator).repeat(3, 1, 1) for name, shape in SHAPES.items()}
    noise = torch.randn(1, *SHAPES[level], generator=generator).repeat(3, 1, 1)
    graphs, bias = pad_batch(captions, [np.ones(len(each.kind), dtype=bool) for each in captions])
    coarse = {"action": latents["motion"], "specific": latents["action"]}
    batch = DenoiserBatch(graphs, bias, latents, coarse, torch.zeros(3), torch.full((3,), 60), rows=join_plans(plans))
    with torch.no_grad():
        return module.predict_noise(level, module.hierarchy.encode(graphs), batch, torch.full((3,), 20), noise)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("concepts", [["walks", "waves"], ["walks", "waves", "nods"]])
def test_eq_7_adds_what_each_concept_adds_to_no_text(module: DenoiserModule, level: str, concepts: list[str]) -> None:
    alone = predict(module, level, [as_partial(graph(concept)) for concept in concepts])
    no_text = predict(module, level, [null_graph(graph("walks"))])
    expected = no_text + (alone - no_text).sum(dim=0, keepdim=True)
    found = predict_composed(module, level, concepts, LATENT_AWARE)
    torch.testing.assert_close(found[1:2], expected, atol=2e-5, rtol=1e-4)
    assert (alone[0] - alone[1]).abs().max() > 1e-2
    # Neighbours in the batch are as they are alone.
    torch.testing.assert_close(found[[0, 2]], predict(module, level, [graph("runs"), graph("sits")]), atol=2e-5, rtol=0)


@pytest.mark.parametrize("level", LEVELS)
def test_eq_9_means_attention_inside_every_layer(module: DenoiserModule, level: str) -> None:
    # The mean is that of the attention's outputs: the same concept twice changes nothing ...
    twice = predict_composed(module, level, ["walks", "walks"], SEMANTIC_AWARE)[1:2]
    once = predict(module, level, [as_partial(graph("walks"))])
    torch.testing.assert_close(twice, once, atol=2e-5, rtol=1e-4)
    # ... their order neither, and two are not the mean of their predictions.
    found = predict_composed(module, level, ["walks", "waves"], SEMANTIC_AWARE)[1:2]
    turned = predict_composed(module, level, ["waves", "walks"], SEMANTIC_AWARE)[1:2]
    torch.testing.assert_close(found, turned, atol=2e-5, rtol=1e-4)
    mean = predict(module, level, [as_partial(graph("walks")), as_partial(graph("waves"))]).mean(dim=0, keepdim=True)
    assert (found - mean).abs().max() > 1e-3

    # By hand: in every layer, the mean of both concepts' attention takes the place of each one's.
    def attend(x: Any, key: Any, value: Any, bias: Any, mixing: Any, *, attention: Any) -> Any:
        own = type(attention).forward
        each = [own(attention, x[:1], key[i : i + 1], value[i : i + 1], bias[i : i + 1], None) for i in (0, 1)]
        return ((each[0] + each[1]) / 2).repeat(2, 1, 1)

    with pytest.MonkeyPatch.context() as patch:
        for layer in module.hierarchy.levels[level].step.layers:
            attention = layer.cross_attention
            patch.setattr(attention, "forward", partial(attend, attention=attention))
        expected = predict(module, level, [as_partial(graph("walks")), as_partial(graph("waves"))])[:1]
    torch.testing.assert_close(found, expected, atol=2e-5, rtol=1e-4)


def test_one_concept_is_a_plain_prediction() -> None:
    for lambdas in (LATENT_AWARE, SEMANTIC_AWARE):
        plan = plan_concepts(1, lambdas)
        assert plan.coefficients.tolist() == [1.0] and plan.routing.src.tolist() == [0]
        assert plan.routing.combine.tolist() == [[1.0]]


def test_splices_are_composed_as_often_as_said() -> None:
    collate = batches(0.6)
    rows = collate([0, 1, 2] * 1000).rows
    assert rows is not None
    composed = rows.composed.reshape(1000, 3).double().mean(dim=0)
    assert composed[0] == 0.0
    np.testing.assert_allclose(composed[1:].numpy(), PARTIAL_CAPTIONS * 0.6, atol=0.05)
    # Latent-aware, a sample has one row for each concept and one without text; semantic-aware it has one in all.
    per_sample = np.bincount(rows.sample.numpy(), minlength=3000)[rows.composed.numpy()]
    assert set(per_sample.tolist()) == {1, 3, 4}
    assert np.mean(per_sample == 1) == pytest.approx(0.5, abs=0.06)
    assert batches(0.0)([0, 1, 2] * 50).rows is None
    assert batches(1.0, augment=False)([0, 1, 2] * 50).rows is None


def test_what_is_composed_keeps_its_text_and_shares_one_coarser_latent() -> None:
    batch = batches(1.0)([1, 2] * 300)
    rows = batch.rows
    assert rows is not None
    of_graph = rows.composed[rows.attention_sample]
    kinds = batch.graph.kind[of_graph, 0]
    assert set(kinds.tolist()) == {PARTIAL_KIND, NULL_KIND}
    # As many without text as there are latent-aware samples.
    per_sample = np.bincount(rows.sample.numpy(), minlength=600)[rows.composed.numpy()]
    assert int((kinds == NULL_KIND).sum()) == int((per_sample > 1).sum())
    assert (batch.node_bias[of_graph, 0] == 0).all()
    lost = (batch.coarse_bias == PADDING_BIAS).double().mean()
    assert 0.3 < float(lost) < 0.5


def test_losses_of_composed_batches_are_of_samples_and_reach_every_caption(module: DenoiserModule) -> None:
    batch = batches(1.0)([0, 1, 2, 1, 2, 1, 2, 1])
    assert batch.rows is not None and batch.rows.composed.any()
    nodes = batch.graph.nodes.clone().requires_grad_()
    losses = module.losses(replace(batch, graph=replace(batch.graph, nodes=nodes)))
    assert {level: value.shape for level, value in losses.items()} == dict.fromkeys(LEVELS, (8,))
    sum(value.sum() for value in losses.values()).backward()
    reached = nodes.grad.abs().sum(dim=(1, 2)) > 0
    with_text = (batch.graph.kind != NULL_KIND).all(dim=1)
    assert reached[with_text].all()


def test_concepts_name_every_action_once() -> None:
    two = {draw_concepts(TWO, 2, RNG) for _ in range(60)}
    assert two == {(first, second) for first in TWO[:2] for second in TWO[2:]}
    three = {draw_concepts(THREE, 3, RNG) for _ in range(60)}
    assert three == {THREE[:3], ("walks", "waves and nods"), ("waves", "walks and nods"), ("nods", "walks and waves")}
    # And that is the order in which partial captions are written.
    written = partial_captions(("walk", "wave-right-hand"), "normal", np.random.default_rng(0))
    assert len(written) == 4 and all("walk" in text for text in written[:2])
    assert not any("walk" in text for text in written[2:])
