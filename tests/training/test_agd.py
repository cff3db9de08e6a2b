"""Adaptive gradient descent (EnergyMoGen, Eq. 3, 4) against autograd of its energy, layer by layer, row by row."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

import numpy as np
import onnxruntime

from kinegraph.bundle.contract import PADDING_BIAS, LevelSpec, context_agd, denoiser_agd
from kinegraph.diffusion.composition import CompositionWeights, agd_step_sizes, combine_rows, plan_rows
from kinegraph_export.graphs import export_graph
from kinegraph_export.modules import AgdContextGraph, AgdDenoiserGraph, ContextGraph, DenoiserGraph
from kinegraph_export.onnx_export import round_weights
from kinegraph_training.models.agd import AgdNoisePredictor
from kinegraph_training.models.denoiser import Denoiser, DenoiserConfig, LatentShape

WIDTH, LAYERS, HEADS, CHANNELS = 64, 3, 2, 6
CONFIG = DenoiserConfig(width=WIDTH, layers=LAYERS, heads=HEADS, feed_forward=128, text_width=12, context_layers=1)


@dataclass(frozen=True)
class Case:
    """Random rows of one level: R = 3 predictions, one of them mixed from two concepts, A = 4 attention rows."""

    denoiser: Denoiser
    coarse_tokens: int
    parts: dict[str, torch.Tensor]


def make_case(coarse_tokens: int, tokens: int, nodes: int, gamma: float, seed: int) -> Case:
    torch.manual_seed(seed)
    coarse = LatentShape(coarse_tokens, CHANNELS) if coarse_tokens else None
    denoiser = Denoiser(CONFIG, LatentShape(tokens, CHANNELS), coarse).eval()
    generator = torch.Generator().manual_seed(seed)
    weight = torch.rand(4, nodes + coarse_tokens, generator=generator) + 0.2
    bias = torch.log(weight)
    bias[:, nodes:] = 0.0
    bias[1, nodes - 1] = PADDING_BIAS
    bias[2, : nodes - 2] = PADDING_BIAS
    sizes = torch.rand(4, 2, generator=generator) * gamma
    sizes[0] = 0.0
    parts = {
        "latent": torch.randn(3, tokens, CHANNELS, generator=generator),
        "modulation": torch.randn(3, 6 * LAYERS, WIDTH, generator=generator),
        "context": torch.randn(4, nodes + coarse_tokens, WIDTH, generator=generator),
        "gamma": sizes,
        "src": torch.tensor([0, 1, 2, 2]),
        "combine": torch.tensor([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1.4, -0.4]]),
        "bias": bias[:, None, None, :].expand(-1, -1, tokens, -1).contiguous(),
    }
    return Case(denoiser, coarse_tokens, parts)


def energy(query: torch.Tensor, key: torch.Tensor, log_weight: torch.Tensor, gamma: torch.Tensor) -> torch.Tensor:
    """Of one attention row: query (c, d), key (s, d), as the design writes it; sums by loops."""
    total = torch.zeros(())
    size = WIDTH // HEADS
    beta = 1 / math.sqrt(size)
    for head in range(HEADS):
        span = slice(head * size, (head + 1) * size)
        for token in key:
            total = total + gamma[0] * torch.logsumexp(beta * query[:, span] @ token[span], dim=0) / beta
    norms = torch.stack([token @ token / 2 for token in key])
    return total - gamma[1] * torch.logsumexp(norms + log_weight, dim=0)


def reference(case: Case) -> torch.Tensor:
    """The step network with AGD, written out: attention row by attention row, the context moved by autograd."""
    step, parts = case.denoiser.step, case.parts
    context = [row.clone() for row in parts["context"]]
    x, kept = step.latent_in(parts["latent"]) + step.position, []
    for number, layer in enumerate(step.layers):
        half = LAYERS // 2
        if number > half:
            x = step.joins[number - half - 1](torch.cat([x, kept.pop()], dim=-1))
        m = parts["modulation"][:, 6 * number : 6 * number + 6, None]
        x = x + layer.self_attention(layer.norm(x, m[:, 0], m[:, 1]), None)
        normed = layer.norm(x, m[:, 2], m[:, 3])
        mixed = torch.zeros_like(x)
        for row, source in enumerate(parts["src"].tolist()):
            mixed_row, context[row] = attended(case, number, normed[source], context[row], row)
            mixed = mixed + parts["combine"][:, row, None, None] * mixed_row
        x = x + layer.cross_attention.out(mixed)
        x = x + layer.feed(layer.norm(x, m[:, 4], m[:, 5]))
        if number < half:
            kept.append(x)
    return step.noise_out(step.norm(x)).detach()


def attended(
    case: Case, number: int, x: torch.Tensor, context: torch.Tensor, row: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """What one row reads from its context (c, d), and the context that the next layer sees."""
    layer, project = case.denoiser.step.layers[number], case.denoiser.context.key_value[number]
    query = layer.cross_attention.query(x).detach()
    log_weight, gamma = case.parts["bias"][row, 0, 0], case.parts["gamma"][row]
    free = context.detach().clone().requires_grad_(True)
    key, value = project(free).chunk(2, dim=-1)
    (gradient,) = torch.autograd.grad(energy(query, key, log_weight, gamma), free)
    size, heads = WIDTH // HEADS, []
    for head in range(HEADS):
        span = slice(head * size, (head + 1) * size)
        share = torch.softmax(query[:, span] @ key[:, span].T / math.sqrt(size) + log_weight, dim=-1)
        heads.append(share @ value[:, span])
    moved = context.clone()
    for token in range(len(context) - case.coarse_tokens):
        if log_weight[token] > PADDING_BIAS / 2:
            moved[token] += gradient[token]
    return torch.cat(heads, dim=-1).detach(), moved.detach()


CASES = [(0, 2, 4, 4e-4, 1), (2, 4, 5, 1e-3, 2), (4, 8, 6, 1e-2, 3), (4, 8, 3, 0.05, 4)]


@pytest.mark.parametrize(("coarse", "tokens", "nodes", "gamma", "seed"), CASES)
def test_the_step_is_autograd_of_the_energy(coarse: int, tokens: int, nodes: int, gamma: float, seed: int) -> None:
    case = make_case(coarse, tokens, nodes, gamma, seed)
    with torch.no_grad():
        output = AgdDenoiserGraph(AgdNoisePredictor(case.denoiser))(*case.parts.values())
        still = case.parts | {"gamma": torch.zeros(4, 2)}
        plain = AgdDenoiserGraph(AgdNoisePredictor(case.denoiser))(*still.values())
    torch.testing.assert_close(output, reference(case), atol=1e-4, rtol=0)
    assert not torch.allclose(output, plain, atol=1e-6)
    # a row whose step sizes are 0 is the plain one
    torch.testing.assert_close(output[0], plain[0], atol=1e-6, rtol=0)


def predicted(case: Case, shares: dict[int, float], gamma: tuple[float, float]) -> torch.Tensor:
    """One prediction whose attention is averaged over contexts in every layer; contexts 0 and 1 hold no text."""
    numbers = list(shares)
    parts = case.parts | {
        "latent": case.parts["latent"][:1],
        "modulation": case.parts["modulation"][:1],
        "context": case.parts["context"][numbers],
        "gamma": torch.tensor([gamma if number > 1 else (0.0, 0.0) for number in numbers]),
        "src": torch.zeros(len(numbers), dtype=torch.int64),
        "combine": torch.tensor([list(shares.values())]),
        "bias": case.parts["bias"][numbers],
    }
    return reference(Case(case.denoiser, case.coarse_tokens, parts))[0]


MIXTURES = [
    CompositionWeights((1.0, 0.7)),
    CompositionWeights((1.0, -0.6, 0.4)),
    CompositionWeights((0.8, 1.3, -0.3), lambdas=(0.0, 1.0, 0.0)),
    CompositionWeights((0.8, 1.3), (1.0,), (-1.0,), (0.2, 0.3, 0.5)),
    CompositionWeights((1.2,), (1.3, -0.3), (-0.5, -0.2), (0.1, 0.0, 0.9)),
]


@pytest.mark.parametrize("mixture", MIXTURES, ids=str)
@pytest.mark.parametrize("gamma", [(0.0, 0.0), (4e-4, 1e-3), (0.02, 0.01)])
@pytest.mark.parametrize(("coarse_tokens", "tokens"), [(0, 2), (2, 4), (4, 8)])
def test_one_run_of_trained_modules_is_equations_7_to_10(
    mixture: CompositionWeights, gamma: tuple[float, float], coarse_tokens: int, tokens: int
) -> None:
    n, joint = len(mixture.concepts), len(mixture.joint)
    case, scale, apart = make_case(coarse_tokens, tokens, 4, 0.0, n), 2.5, coarse_tokens > 0
    generator = torch.Generator().manual_seed(tokens)
    count = 2 + n + joint + len(mixture.negated)
    case.parts["context"] = torch.randn(count, 4 + coarse_tokens, WIDTH, generator=generator)
    case.parts["bias"] = torch.log(torch.rand(count, 1, 1, 4 + coarse_tokens, generator=generator) + 0.2)
    case.parts["bias"][-1, ..., 3] = PADDING_BIAS

    def eps(*shares: tuple[int, float]) -> torch.Tensor:
        return predicted(case, dict(shares), gamma)

    def added(first: int, weights: tuple[float, ...], base: torch.Tensor) -> torch.Tensor:
        terms = [w * (eps((first + k, 1.0)) - base) for k, w in enumerate(weights)]
        return sum(terms, torch.zeros_like(base))

    null = eps((0, 1.0))
    base = eps((1, 1.0)) if apart else null
    by_latent = null + scale * (base - null + added(2, mixture.concepts, base))
    mean = [(2 + k, w / sum(mixture.concepts)) for k, w in enumerate(mixture.concepts)]
    by_meaning = null + scale * (eps(*mean) - null) if mixture.lambdas[1] else null
    by_text = null + scale * added(2 + n, mixture.joint, null)
    fused = sum(share * term for share, term in zip(mixture.lambdas, (by_latent, by_meaning, by_text), strict=True))
    expected = fused + scale * added(2 + n + joint, mixture.negated, base)

    plan = plan_rows(mixture, scale, coarse=apart)
    rows, context = len(plan.coefficients), torch.from_numpy(plan.routing.context)
    graph = AgdDenoiserGraph(AgdNoisePredictor(case.denoiser))
    with torch.no_grad():
        output = graph(
            case.parts["latent"][:1].expand(rows, -1, -1),
            case.parts["modulation"][:1].expand(rows, -1, -1),
            case.parts["context"][context],
            torch.from_numpy(agd_step_sizes(plan.routing, gamma)),
            torch.from_numpy(plan.routing.src),
            torch.from_numpy(plan.routing.combine),
            case.parts["bias"][context],
        )
    np.testing.assert_allclose(combine_rows(output.numpy(), plan.coefficients)[0], expected.numpy(), atol=1e-4)


def nodes_of(seed: int) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)
    return (
        torch.randn(4, 5, 12, generator=generator),
        torch.randint(0, 4, (4, 5), generator=generator),
        torch.randint(0, 4, (4, 5), generator=generator),
        torch.randn(4, 7, generator=generator),
        torch.randn(4, 2, CHANNELS, generator=generator),
    )


@torch.no_grad()
def test_without_step_sizes_it_is_the_plain_step() -> None:
    case = make_case(2, 4, 5, 1.0, 6)
    keys_values = list(ContextGraph(case.denoiser.context)(*nodes_of(6)))
    (context,) = AgdContextGraph(case.denoiser.context)(*nodes_of(6))
    parts = case.parts | {"context": context, "gamma": torch.zeros(4, 2)}
    output = AgdDenoiserGraph(AgdNoisePredictor(case.denoiser))(*parts.values())
    rest = (parts[name] for name in ("src", "combine", "bias"))
    plain = DenoiserGraph(case.denoiser.step)(parts["latent"], parts["modulation"], keys_values, *rest)
    torch.testing.assert_close(output, plain, atol=1e-5, rtol=0)


@torch.no_grad()
def test_every_step_starts_from_the_context_it_is_given() -> None:
    case = make_case(2, 4, 5, 0.05, 7)
    graph, before = AgdDenoiserGraph(AgdNoisePredictor(case.denoiser)), case.parts["context"].clone()
    first, second = (graph(*case.parts.values()) for _ in range(2))
    assert torch.equal(first, second) and torch.equal(case.parts["context"], before)


@torch.no_grad()
def test_padding_has_no_influence() -> None:
    case = make_case(2, 4, 5, 0.05, 8)
    other = case.parts | {"context": case.parts["context"].clone()}
    other["context"][1, 4] += 3.0
    graph = AgdDenoiserGraph(AgdNoisePredictor(case.denoiser))
    assert torch.equal(graph(*case.parts.values()), graph(*other.values()))


LEVEL = LevelSpec(4, CHANNELS, WIDTH, HEADS, LAYERS, ("motion",))


@pytest.mark.usefixtures("traces")
@pytest.mark.parametrize("precision", ["fp32", "int8"])
def test_the_exported_step_is_the_network_and_moves_its_context(precision: str) -> None:
    case = make_case(2, 4, 5, 0.02, 9)
    round_weights(case.denoiser)
    contract = denoiser_agd("action", LEVEL)
    data, parity = export_graph(AgdDenoiserGraph(AgdNoisePredictor(case.denoiser)), contract, 4, precision)  # type: ignore[arg-type]
    assert parity["denoiser_action_agd"] <= 1e-4
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    (output,) = session.run(["noise"], {name: part.numpy() for name, part in case.parts.items()})
    np.testing.assert_allclose(output, reference(case).numpy(), atol=1e-4 if precision == "fp32" else 0.1)
    moved, still = ({name: part.numpy() for name, part in case.parts.items()} for _ in range(2))
    still["gamma"] = np.zeros_like(still["gamma"])
    assert np.abs(session.run(None, moved)[0] - session.run(None, still)[0]).max() > 1e-4


@pytest.mark.usefixtures("traces")
def test_the_exported_context_is_what_keys_are_made_of() -> None:
    case = make_case(2, 4, 5, 0.02, 9)
    round_weights(case.denoiser)
    above = LevelSpec(2, CHANNELS, WIDTH, HEADS, LAYERS, ("motion",))
    contract = context_agd("action", LEVEL, 12, above)
    data, _ = export_graph(AgdContextGraph(case.denoiser.context), contract, 4, "int8")
    names = [spec.name for spec in contract.inputs]
    inputs = dict(zip(names, (part.numpy() for part in nodes_of(3)), strict=True))
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    (context,) = session.run(["context"], inputs)
    with torch.no_grad():
        keys = ContextGraph(case.denoiser.context)(*nodes_of(3))[::2]
        for key, project in zip(keys, case.denoiser.context.key_value, strict=True):
            merged = project(torch.from_numpy(context))[..., :WIDTH]
            torch.testing.assert_close(merged, key.transpose(1, 2).reshape(merged.shape), atol=1e-4, rtol=0)
