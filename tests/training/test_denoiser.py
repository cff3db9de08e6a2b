"""The denoisers: what is split off for speed must not change what is computed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from kinegraph.bundle.contract import KINDS, NULL_KIND, PADDING_BIAS
from kinegraph_export.modules import DenoiserGraph, ModulationGraph
from kinegraph_training.models.denoiser import (
    ContextTokens,
    CrossAttention,
    Denoiser,
    DenoiserConfig,
    LatentShape,
    RowMixing,
)

SIZES = {"width": 16, "layers": 3, "heads": 2, "feed_forward": 32, "text_width": 12, "max_frames": 40}
CONFIG = DenoiserConfig(**SIZES, train_steps=50, words=True, context_layers=2)
LATENT, COARSE = LatentShape(4, 6), LatentShape(2, 5)


@pytest.fixture
def denoiser() -> Denoiser:
    torch.manual_seed(1)
    denoiser = Denoiser(CONFIG, LATENT, COARSE).eval()
    # As trained: at the start neither step nor length says anything.
    torch.nn.init.normal_(denoiser.clock.out.weight, std=0.3)
    for layer in denoiser.context.mixing:
        torch.nn.init.normal_(layer.self_attention.out.weight, std=0.3)
        torch.nn.init.normal_(layer.feed[-1].weight, std=0.3)
    return denoiser


def inputs(rows: int = 3, nodes: int = 5) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(rows)
    return {
        "latent": torch.randn(rows, 4, 6, generator=generator),
        "nodes": torch.randn(rows, nodes, 12, generator=generator),
        "kind": torch.randint(0, 3, (rows, nodes), generator=generator),
        "order": torch.randint(0, 4, (rows, nodes), generator=generator),
        "coarse": torch.randn(rows, 2, 5, generator=generator),
        "bias": torch.randn(rows, nodes + 2, generator=generator),
    }


@torch.no_grad()
def noise(denoiser: Denoiser, step: int = 7, frames: int = 20, **parts: torch.Tensor) -> torch.Tensor:
    """As training calls it."""
    rows = len(parts["latent"])
    context = denoiser.context(parts["nodes"], parts["kind"], parts["order"], parts["bias"], parts["coarse"])
    modulation = denoiser.clock(torch.full((rows,), step), torch.full((rows,), frames))
    return denoiser.step(parts["latent"], modulation, context, parts["bias"][:, None, None, :])


@torch.no_grad()
def test_the_exported_form_of_a_step_is_the_trained_one(denoiser: Denoiser) -> None:
    # The clock of all steps at once, an identity mixing, one bias per latent token: what the runtime feeds.
    parts = inputs()
    context = denoiser.context(parts["nodes"], parts["kind"], parts["order"], parts["bias"], parts["coarse"])
    clock = ModulationGraph(denoiser.clock)(torch.tensor([1, 7, 9]), torch.tensor([11, 20]))
    modulation = clock[1, 1].expand(3, -1, -1)
    bias = parts["bias"][:, None, None, :].expand(-1, -1, 4, -1)
    flat = [part for pair in context for part in pair]
    output = DenoiserGraph(denoiser.step)(parts["latent"], modulation, flat, torch.arange(3), torch.eye(3), bias)
    torch.testing.assert_close(output, noise(denoiser, **parts), atol=1e-5, rtol=0)


@torch.no_grad()
def test_cross_attention_is_the_softmax_written_out(denoiser: Denoiser) -> None:
    module = CrossAttention(8, 2).eval()
    generator = torch.Generator().manual_seed(0)
    x, bias = torch.randn(2, 3, 8, generator=generator), torch.randn(2, 1, 1, 5, generator=generator)
    key, value = torch.randn(2, 2, 2, 5, 4, generator=generator)
    expected = torch.zeros(2, 3, 8)
    for row in range(2):
        query = module.query(x[row])
        for head in range(2):
            for token in range(3):
                scores = [
                    float(query[token, 4 * head : 4 * head + 4] @ key[row, head, s]) / math.sqrt(4)
                    + float(bias[row, 0, 0, s])
                    for s in range(5)
                ]
                share = np.exp(scores) / np.exp(scores).sum()
                mean = sum(float(w) * value[row, head, s] for s, w in enumerate(share))
                expected[row, token, 4 * head : 4 * head + 4] = mean
    torch.testing.assert_close(module(x, key, value, bias, None), module.out(expected), atol=1e-5, rtol=0)


@torch.no_grad()
def test_mixing_sums_attention_rows_before_the_output(denoiser: Denoiser) -> None:
    # Two concepts attend from one latent row; EnergyMoGen's Eq. 9 mixes what they attend to.
    module = CrossAttention(8, 2).eval()
    x, bias = torch.randn(1, 3, 8), torch.zeros(2, 1, 1, 5)
    key, value = torch.randn(2, 2, 2, 5, 4)
    mixed = module(x, key, value, bias, RowMixing(torch.tensor([0, 0]), torch.tensor([[0.7, 0.3]])))
    single = [module(x, key[i : i + 1], value[i : i + 1], bias[i : i + 1], None) for i in range(2)]
    torch.testing.assert_close(mixed, 0.7 * single[0] + 0.3 * single[1], atol=1e-5, rtol=0)


@torch.no_grad()
def test_the_clock_scales_and_shifts_what_is_normalised(denoiser: Denoiser) -> None:
    # A layer by hand: every branch reads LayerNorm(x) * scale + shift, with scales and shifts of its own.
    layer = denoiser.step.layers[0]
    generator = torch.Generator().manual_seed(0)
    x, bias = torch.randn(2, 4, 16, generator=generator), torch.zeros(2, 1, 1, 5)
    pair = tuple(torch.randn(2, 2, 2, 5, 8, generator=generator))
    pieces = list(torch.randn(6, 2, 1, 16, generator=generator))

    def read(x: torch.Tensor, index: int) -> torch.Tensor:
        deviation = torch.sqrt(x.var(dim=-1, keepdim=True, unbiased=False) + 1e-5)
        return (x - x.mean(dim=-1, keepdim=True)) / deviation * pieces[2 * index] + pieces[2 * index + 1]

    expected = x + layer.self_attention(read(x, 0), None)
    expected = expected + layer.cross_attention(read(expected, 1), *pair, bias, None)
    expected = expected + layer.feed(read(expected, 2))
    torch.testing.assert_close(layer(x, pieces, pair, bias, None), expected, atol=1e-5, rtol=0)


@torch.no_grad()
def test_an_untrained_clock_leaves_normalisation_alone() -> None:
    modulation = Denoiser(CONFIG, LATENT, COARSE).clock(torch.tensor([3, 40]), torch.tensor([16, 40]))
    assert modulation.shape == (2, 18, 16)
    assert (modulation[:, 0::2] == 1).all() and (modulation[:, 1::2] == 0).all()


def test_masked_nodes_have_no_influence(denoiser: Denoiser) -> None:
    parts = inputs()
    parts["bias"][:, 3] = PADDING_BIAS
    other = {**parts, "nodes": parts["nodes"].clone()}
    other["nodes"][:, 3] = 100.0
    assert torch.equal(noise(denoiser, **parts), noise(denoiser, **other))


@torch.no_grad()
def test_context_layers_are_the_attention_of_tokens_to_one_another_written_out(denoiser: Denoiser) -> None:
    parts, encoder = inputs(rows=1), denoiser.context
    given = [parts[name] for name in ("nodes", "kind", "order", "bias", "coarse")]
    mixing, encoder.mixing = encoder.mixing, torch.nn.ModuleList()
    x = ContextTokens.forward(encoder, *given)[0]
    encoder.mixing = mixing
    for layer in mixing:
        query, key, value = layer.self_attention.qkv(layer.norm_self(x)).chunk(3, dim=-1)
        heads = []
        for head in range(2):
            part = slice(8 * head, 8 * head + 8)
            scores = query[:, part] @ key[:, part].T / math.sqrt(8) + parts["bias"][0]
            heads.append(scores.softmax(dim=-1) @ value[:, part])
        x = x + layer.self_attention.out(torch.cat(heads, dim=-1))
        x = x + layer.feed(layer.norm_feed(x))
    torch.testing.assert_close(ContextTokens.forward(encoder, *given)[0], x, atol=1e-5, rtol=0)


@torch.no_grad()
def test_untrained_context_layers_change_nothing() -> None:
    torch.manual_seed(1)
    mixed = ContextTokens(CONFIG, COARSE).eval()
    plain = ContextTokens(replace(CONFIG, context_layers=0), COARSE).eval()
    plain.load_state_dict({name: value for name, value in mixed.state_dict().items() if "mixing" not in name})
    given = [inputs()[name] for name in ("nodes", "kind", "order", "bias", "coarse")]
    torch.testing.assert_close(mixed(*given), plain(*given), atol=0, rtol=0)


@torch.no_grad()
def test_a_hidden_token_is_a_token_that_is_not_there(denoiser: Denoiser) -> None:
    # Nodes 1 and 4, an action and a word of it, without weight; keys and values of the others are as without them.
    parts = inputs()
    parts["kind"] = torch.tensor([[0, 1, 1, 4, 4]] * 3)
    parts["bias"][:, [1, 4]] = PADDING_BIAS
    left, tokens = [0, 2, 3], [0, 2, 3, 5, 6]
    whole = denoiser.context(parts["nodes"], parts["kind"], parts["order"], parts["bias"], parts["coarse"])
    cut = [parts[name][:, left] for name in ("nodes", "kind", "order")]
    alone = denoiser.context(*cut, parts["bias"][:, tokens], parts["coarse"])
    for pair, expected in zip(whole, alone, strict=True):
        for part, other in zip(pair, expected, strict=True):
            torch.testing.assert_close(part[:, :, tokens], other, atol=1e-5, rtol=0)


@pytest.mark.parametrize("kind", ["null", "partial"])
def test_learned_tokens_do_not_read_their_node(denoiser: Denoiser, kind: str) -> None:
    parts = inputs()
    parts["kind"][:, 0] = KINDS[kind]
    other = {**parts, "nodes": parts["nodes"].clone(), "order": parts["order"].clone()}
    other["nodes"][:, 0] += 1.0
    other["order"][:, 0] += 1
    assert torch.equal(noise(denoiser, **parts), noise(denoiser, **other))


def test_the_null_token_does_not_read_its_node(denoiser: Denoiser) -> None:
    parts = inputs()
    parts["kind"] = torch.full_like(parts["kind"], NULL_KIND)
    other = {**parts, "nodes": parts["nodes"] + 1.0, "order": parts["order"] + 1}
    assert torch.equal(noise(denoiser, **parts), noise(denoiser, **other))
    seen = {**parts, "kind": torch.zeros_like(parts["kind"])}
    assert not torch.allclose(noise(denoiser, **parts), noise(denoiser, **seen), atol=1e-4)


@pytest.mark.parametrize("changed", ["nodes", "order", "coarse", "step", "frames"])
def test_every_condition_matters(denoiser: Denoiser, changed: str) -> None:
    parts = inputs()
    before = noise(denoiser, **parts)
    if changed in ("step", "frames"):
        after = noise(denoiser, **parts, **{changed: 30})
    else:
        after = noise(denoiser, **{**parts, changed: parts[changed] + 1})
    assert not torch.allclose(before, after, atol=1e-4)


def test_later_orders_share_the_last_embedding(denoiser: Denoiser) -> None:
    parts = inputs()
    far, farther = ({**parts, "order": torch.full_like(parts["order"], order)} for order in (15, 30))
    assert torch.equal(noise(denoiser, **far), noise(denoiser, **farther))
