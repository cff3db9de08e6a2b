"""Models for comparison only: GraphMotion's own denoiser, a single stage, and plain tokens instead of the graph."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from kinegraph.bundle.contract import LEVELS, NULL_KIND, PADDING_BIAS
from kinegraph.errors import InvalidInputError
from kinegraph_export.graphs import TrainedModels, check_exportable, level_specs
from kinegraph_training.data.caption_cache import tokens_as_graph
from kinegraph_training.models.concat_denoiser import ConcatDenoiser
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.frame_denoiser import hide_padding
from kinegraph_training.models.hierarchy import GraphBatch, Hierarchy
from kinegraph_training.models.vae import MotionVae, VaeConfig

SIZE = {"width": 16, "layers": 3, "heads": 2, "feed_forward": 32, "text_width": 12}


def config(**changes: object) -> DenoiserConfig:
    return DenoiserConfig(**{**SIZE, **changes})  # type: ignore[arg-type]


def hierarchy(**changes: object) -> Hierarchy:
    torch.manual_seed(0)
    model_config = config(**changes)
    return Hierarchy(model_config, {level: LatentShape(2 + n, 6) for n, level in enumerate(model_config.levels)}).eval()


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "add"}, {"condition": "audio"}, {"nodes_seen": "some"}, {"levels": ()}, {"levels": ("motion",)},
        {"levels": ("specific", "motion")}, {"levels": ("action", "action", "specific")}, {"levels": ("fine",)},
    ],
)  # fmt: skip
def test_a_model_that_does_not_exist_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        config(**wrong)


def test_which_nodes_a_level_sees() -> None:
    nodes = ("motion", "action", "specific")
    assert [config().kinds_seen(level) for level in LEVELS] == [nodes[:1], nodes[:2], nodes]
    assert [config(nodes_seen="all").kinds_seen(level) for level in LEVELS] == [nodes] * 3
    assert [config(words=True).kinds_seen(level)[-1] for level in LEVELS] == ["word"] * 3
    assert [config(condition="tokens").kinds_seen(level) for level in LEVELS] == [nodes[:1]] * 3
    assert config(condition="sentence", levels=("specific",)).kinds_seen("specific") == nodes[:1]


@torch.no_grad()
def test_concat_sees_its_conditions_and_nothing_that_is_masked() -> None:
    torch.manual_seed(3)
    denoiser = ConcatDenoiser(config(kind="concat"), LatentShape(4, 6), LatentShape(2, 6)).eval()
    nodes, kind = torch.randn(2, 5, 12), torch.randint(0, 3, (2, 5))
    order, coarse, latent = torch.zeros(2, 5, dtype=torch.int64), torch.randn(2, 2, 6), torch.randn(2, 4, 6)
    time = denoiser.clock(torch.tensor([3, 3]), torch.tensor([40, 40]))
    bias = torch.zeros(2, 7)
    bias[:, 4] = PADDING_BIAS

    def noise(nodes: torch.Tensor, coarse: torch.Tensor, kind: torch.Tensor = kind) -> torch.Tensor:
        return denoiser.step(latent, time, denoiser.context(nodes, kind, order, bias, coarse), bias[:, None, None, :])

    plain = noise(nodes, coarse)
    assert plain.shape == (2, 4, 6)
    hidden = nodes.clone()
    hidden[:, 4] = 50.0
    assert torch.equal(noise(hidden, coarse), plain)
    seen = nodes.clone()
    seen[:, 1] += 1.0
    assert not torch.allclose(noise(seen, coarse), plain, atol=1e-4)
    assert not torch.allclose(noise(nodes, coarse + 1), plain, atol=1e-4)
    null = torch.full_like(kind, NULL_KIND)
    assert torch.equal(noise(nodes, coarse, null), noise(nodes + 1, coarse, null))


@torch.no_grad()
def test_concat_takes_any_number_of_frames_and_never_sees_padding() -> None:
    torch.manual_seed(3)
    denoiser = ConcatDenoiser(config(kind="concat"), LatentShape(9, 6), None).eval()
    kind, bias = torch.randint(0, 3, (2, 5)), torch.zeros(2, 5)
    context = denoiser.context(torch.randn(2, 5, 12), kind, torch.zeros_like(kind), bias)
    given = (denoiser.clock(torch.tensor([3, 3]), torch.tensor([40, 40])), context, bias[:, None, None])
    noisy = torch.randn(2, 7, 6)
    alone = denoiser.step(noisy[:, :5], *given)
    mask = torch.tensor([1.0] * 5 + [0.0] * 2).expand(2, -1)
    padded = denoiser.step(noisy, *given, padding=hide_padding(mask, PADDING_BIAS))
    assert alone.shape == (2, 5, 6)
    torch.testing.assert_close(padded[:, :5], alone, atol=1e-5, rtol=0)
    assert not torch.allclose(denoiser.step(noisy, *given)[:, :5], alone, atol=1e-3), "padding would be seen"


def test_one_stage_has_one_denoiser_without_a_coarser_latent() -> None:
    model = hierarchy(levels=("specific",), condition="sentence")
    assert list(model.levels) == ["specific"]
    assert model.levels["specific"].context.coarse_in is None


@torch.no_grad()
def test_without_reasoning_nodes_stay_as_they_are() -> None:
    generator = torch.Generator().manual_seed(0)
    nodes = torch.randn(1, 3, 12, generator=generator)
    graph = GraphBatch(
        nodes=nodes,
        relation=torch.full((1, 3, 3), 11),
        edge_weight=torch.ones(1, 3, 3),
        node_mask=torch.ones(1, 3),
        kind=torch.zeros(1, 3, dtype=torch.int64),
        order=torch.zeros(1, 3, dtype=torch.int64),
    )
    assert torch.equal(hierarchy(reasoning=False).encode(graph), nodes)
    assert torch.equal(hierarchy(condition="tokens").encode(graph), nodes)
    assert not torch.allclose(hierarchy().encode(graph), nodes, atol=1e-3)


def test_words_without_a_graph_are_nodes_without_edges() -> None:
    hidden = np.arange(12, dtype=np.float32).reshape(3, 4)
    graph = tokens_as_graph(hidden)
    np.testing.assert_array_equal(graph.nodes, [[4, 5, 6, 7], *hidden.tolist()])
    assert (graph.relation >= 0).sum() == 4 and (graph.kind == 0).all()


def trained(**changes: object) -> TrainedModels:
    shape = VaeConfig(features=137, tokens=8, latent_width=6, width=16, layers=3, heads=2, feed_forward=32)
    return TrainedModels(hierarchy(**changes), MotionVae(shape), torch.zeros(8, 6), torch.ones(8, 6))


@pytest.mark.parametrize(
    "changes", [{"kind": "concat"}, {"condition": "tokens"}, {"reasoning": False}, {"levels": ("specific",)}]
)
def test_only_the_product_is_exported(changes: dict[str, object]) -> None:
    check_exportable(trained())
    with pytest.raises(InvalidInputError, match=next(iter(changes))):
        check_exportable(trained(**changes))


def test_the_manifest_says_which_nodes_a_level_sees() -> None:
    assert [len(spec.nodes) for spec in level_specs(trained()).values()] == [1, 2, 3]
    assert [len(spec.nodes) for spec in level_specs(trained(nodes_seen="all")).values()] == [3, 3, 3]
