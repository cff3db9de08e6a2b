"""One run of the exported graphs, composed in numpy, against torch on the same weights: Eq. 7-10 written out, attention
averaged layer by layer, one prediction at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

import onnxruntime
from torch import Tensor

from kinegraph.bundle.contract import LEVELS, NODE_KINDS, NULL_KIND, PADDING_BIAS, LevelSpec, contracts
from kinegraph.conditioning import Conditions
from kinegraph.denoising import bind_step_inputs
from kinegraph.diffusion.composition import CompositionWeights, combine_rows, plan_rows
from kinegraph_export.graphs import export_graph
from kinegraph_export.modules import ContextGraph, DenoiserGraph, MotionContextGraph
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.hierarchy import Hierarchy
from kinegraph_training.models.transformer import attend, merge_heads, split_heads

CONFIG = DenoiserConfig(width=16, layers=3, heads=2, feed_forward=32, text_width=12, max_frames=40, context_layers=2)
LATENTS = {name: LatentShape(tokens, 3) for name, tokens in zip(LEVELS, (1, 2, 4), strict=True)}
NODES = 5


@dataclass(frozen=True)
class Level:
    """A random denoiser and its two exported graphs."""

    denoiser: torch.nn.Module
    context: onnxruntime.InferenceSession
    network: onnxruntime.InferenceSession
    coarse: int
    """Tokens of the level above, 0 at the first."""


@pytest.fixture(scope="module", params=LEVELS)
def level(request: pytest.FixtureRequest) -> Level:
    torch.manual_seed(3)
    name = request.param
    denoiser = Hierarchy(CONFIG, LATENTS).eval().levels[name]
    for layer in denoiser.context.mixing:  # as trained: at the start they change nothing
        torch.nn.init.normal_(layer.self_attention.out.weight, std=0.3)
        torch.nn.init.normal_(layer.feed[-1].weight, std=0.3)
    specs = {each: LevelSpec(shape.tokens, shape.width, 16, 2, 3, NODE_KINDS) for each, shape in LATENTS.items()}
    declared = contracts(specs, CONFIG.text_width, 137)
    wrap = MotionContextGraph if name == LEVELS[0] else ContextGraph
    modules = {f"context_{name}": wrap(denoiser.context), f"denoiser_{name}": DenoiserGraph(denoiser.step)}
    sessions = [
        onnxruntime.InferenceSession(
            export_graph(module.eval(), declared[graph], 4, "fp32")[0], providers=["CPUExecutionProvider"]
        )
        for graph, module in modules.items()
    ]
    above = LEVELS.index(name) - 1
    return Level(denoiser, *sessions, coarse=LATENTS[LEVELS[above]].tokens if above >= 0 else 0)


def drawn(count: int, rng: np.random.Generator) -> Conditions:
    """Nothing, no text, and `count` graphs with weights and padding."""
    kind = rng.choice([0, 1, 2, 4, 5], (count + 2, NODES))
    kind[:2] = NULL_KIND
    bias = np.log(rng.uniform(0.2, 2.0, (count + 2, NODES)))
    bias[rng.random(bias.shape) < 0.3] = PADDING_BIAS
    bias[:2] = PADDING_BIAS
    bias[:, 0] = 0.0
    coarse_bias = np.zeros((count + 2, 1))
    coarse_bias[0] = PADDING_BIAS
    return Conditions(
        rng.standard_normal((count + 2, NODES, 12)).astype(np.float32),
        kind,
        rng.integers(0, 4, kind.shape),
        bias.astype(np.float32),
        coarse_bias.astype(np.float32),
    )


class Averaged:
    """Cross-attention of one layer, Eq. 9: z' = sum_i w_i z'_i / sum_i w_i over contexts that are attended to alone."""

    def __init__(self, trained: torch.nn.Module, parts: Sequence[tuple[float, Tensor, Tensor, Tensor]]) -> None:
        self.trained, self.parts = trained, parts

    def __call__(self, x: Tensor, *_: object) -> Tensor:
        query = split_heads(self.trained.query(x), 2)
        total = sum(share for share, *_ in self.parts)
        found = [share * merge_heads(attend(query, key, value, bias)) for share, key, value, bias in self.parts]
        return self.trained.out(sum(found) / total)


@torch.no_grad()
def predicted(
    level: Level, latent: Tensor, modulation: Tensor, known: Conditions, coarse: Tensor | None, shares: dict[int, float]
) -> Tensor:
    """eps for one latent (1, c, z) whose attention is averaged over contexts."""
    made = []
    for context, share in shares.items():
        row = slice(context, context + 1)
        inputs = [torch.from_numpy(part[row]) for part in (known.nodes, known.kind, known.order)]
        bias = torch.from_numpy(
            np.concatenate([known.bias[row], np.repeat(known.coarse_bias[row], level.coarse, 1)], 1)
        )
        made.append((share, level.denoiser.context(*inputs, bias, coarse), bias[:, None, None]))
    layers = level.denoiser.step.layers
    for number, layer in enumerate(layers):
        parts = [(share, *pairs[number], bias) for share, pairs, bias in made]
        layer.cross_attention.forward = Averaged(layer.cross_attention, parts)
    try:
        none = [(torch.zeros(0), torch.zeros(0))] * len(layers)
        return level.denoiser.step(latent, modulation, none, torch.zeros(0))
    finally:
        for layer in layers:
            del layer.cross_attention.forward


LAMBDAS = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.1, 0.7, 0.2), (0.2, 0.0, 0.8)]


@pytest.mark.parametrize("lambdas", LAMBDAS, ids=str)
@pytest.mark.parametrize(
    ("weights", "negated"),
    [((1.0,), ()), ((0.8, 1.3), ()), ((1.0, 0.7, -0.4), ()), ((1.0,), (-1.0,)), ((0.6, 0.9), (-0.5, -1.2))],
    ids=str,
)
def test_one_run_of_the_graphs_is_the_equations(
    level: Level, weights: tuple[float, ...], negated: tuple[float, ...], lambdas: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(len(weights))
    known = drawn(len(weights) + 1 + len(negated), rng)
    latent = rng.standard_normal((1, level.network.get_inputs()[0].shape[1], 3)).astype(np.float32)
    above = rng.standard_normal((1, level.coarse, 3)).astype(np.float32) if level.coarse else None
    modulation = rng.normal(0.5, 0.5, (1, 18, 16)).astype(np.float32)
    scale = 2.5

    plan = plan_rows(CompositionWeights(weights, (1.0,), negated, lambdas), scale, coarse=above is not None)
    rows = len(plan.coefficients)
    shared = None if above is None else np.repeat(above, len(known.kind), axis=0)
    spread = np.repeat(modulation[None], rows, axis=1)
    network = bind_step_inputs(level.context, level.network, known, shared, plan.routing, spread)
    found = combine_rows(network(np.repeat(latent, rows, axis=0), 0), plan.coefficients)

    coarse = None if above is None else torch.from_numpy(above)
    given = (torch.from_numpy(latent), torch.from_numpy(modulation), known, coarse)

    def eps(shares: dict[int, float]) -> Tensor:
        return predicted(level, *given, shares)

    concepts = dict(enumerate(weights, start=2))
    nothing = eps({0: 1.0})
    base = nothing if above is None else eps({1: 1.0})
    joint = len(weights) + 2
    by_latent = nothing + scale * (base - nothing + sum(w * (eps({i: 1.0}) - base) for i, w in concepts.items()))
    by_meaning = nothing + scale * (eps(concepts) - nothing)
    by_text = nothing + scale * (eps({joint: 1.0}) - nothing)
    fused = lambdas[0] * by_latent + lambdas[1] * by_meaning + lambdas[2] * by_text
    expected = fused + scale * sum(w * (eps({i: 1.0}) - base) for i, w in enumerate(negated, start=joint + 1))
    np.testing.assert_allclose(found, expected.numpy(), atol=1e-4)
