"""What is sampled: one graph, or a composition of concepts, validated before any model runs.

    Concept, ...  --validate_composition-->  CompositionSpec   what the caller asked for
    CompositionSpec or a graph  -->  SamplingPlan              graphs without edge weights, and their CompositionWeights
    CompositionWeights  --diffusion.composition.plan_rows-->  RowPlan          the predictions of each step (Eq. 7-10)

A weight on an edge of a graph is a composition too: `weighted_edge_terms` expands it into graphs with and without the
node that the edge leads to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, chain
from typing import Any, Final

from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.edits import with_weight, without
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.limits import MAX_CONCEPTS, MAX_ROWS
from kinegraph.text.parser import check_caption
from kinegraph.validation import finite_number, short_repr

METHODS: Final = ("latent", "semantic", "fused")
"""Ways to compose in one run (Eq. 7-10)."""
AUTO: Final = "auto"
"""`PARTS` where concepts are for different parts of the body and nothing is weighed, else "fused"."""
PARTS: Final = "parts"
"""Each concept sampled alone, and its parts of the body joined (`part_composition`)."""
DEFAULT_LAMBDAS: Final = (0.3, 0.3, 0.4)
"""Shares of the latent-aware, semantic-aware and joint-text terms.

EnergyMoGen has 0.1, 0.7, 0.2 (Table 7). On 12 pairs that training never joined, both actions happen in 49 % of 120
clips of studio 0.9.0 with the default, in 41 % with those, in 46 % and 33 % by the latent- and the semantic-aware term
alone, and in 68 % by the joint text alone (`kinegraph_benchmarks.quality.composition`). With (0.2, 0.1, 0.7) as many
happen, and the weights of concepts hardly count.
"""
NEGATION_WEIGHT: Final = -1.0
"""Default weight of what must not happen.

At -1, negating one of two actions that a sentence names suppresses it in 95 % of clips and leaves the other; at -0.5 it
suppresses 36 %. It also takes what the unwanted has in common with the wanted: "not runs" leaves 10 % of the walks, and
all at -0.5 (`kinegraph_benchmarks.quality.composition_settings`, studio 0.8.0).
"""
SPOKEN_NEGATION_WEIGHT: Final = -0.5
"""Weight of an action that a sentence itself negates ("without waving").

The rest of the sentence does not name it, so less than -1 is enough. Over 74 sentences in eight forms the action is
gone in 99.7 % of the clips, and the rest holds as often as without the negation
(`kinegraph_benchmarks.quality.negations`, studio 0.8.0). At -1, "walks, not running" loses walks.
"""
MAX_STEP_SIZE: Final = 1.0
"""Largest step size of adaptive gradient descent.

From 0.1 on EnergyMoGen's motions are spoilt (Table 9), and so are the default bundle's
(`kinegraph_benchmarks.quality.composition_settings`).
"""
MAX_WEIGHT: Final = 10.0
MIN_SUM: Final = 0.05
MAX_RATIO: Final = 5.0
"""Eq. 9 divides by the sum of the weights: a small or negative sum flips or inflates every sign."""
UPWEIGHT_GAIN: Final = 0.4
"""Slope of an edge weight beyond 1.

At twice a node's own prediction and more, motions leave what a model knows, and a turn or a speed falls again
(`kinegraph_benchmarks.quality.edit_curves`).
"""


@dataclass(frozen=True)
class Concept:
    """One motion of a composition, with its weight.

    Raises:
        InvalidInputError: no text and no graph, or a weight that is 0, not finite, or beyond 10.
    """

    text: str | SemanticGraph
    """A sentence, or its graph."""
    weight: float = 1.0
    """w_i of Eq. 7 to 9; negative for what must not happen."""

    def __post_init__(self) -> None:
        if not isinstance(self.text, SemanticGraph):
            check_caption(self.text)
        weight = finite_number(self.weight)
        if weight is None:
            raise InvalidInputError(f"the weight of a concept must be a finite number, not {short_repr(self.weight)}")
        if weight == 0 or abs(weight) > MAX_WEIGHT:
            raise InvalidInputError(
                f"the weight of a concept must be -{MAX_WEIGHT:g} to {MAX_WEIGHT:g} and not 0, not {weight:g}; "
                "leave out what counts for nothing"
            )

    @property
    def caption(self) -> str:
        """The sentence of the concept."""
        return self.text.caption if isinstance(self.text, SemanticGraph) else self.text


def validate_concepts(concepts: object) -> tuple[Concept, ...]:
    """Check a list of concepts; plain sentences and graphs get weight 1.

    Raises:
        InvalidInputError: none, too many, or only negations.
    """
    if isinstance(concepts, str | SemanticGraph | Concept) or not isinstance(concepts, Sequence):
        raise InvalidInputError("concepts must be a list of Concept(text, weight)")
    if not 1 <= len(concepts) <= MAX_CONCEPTS:
        raise InvalidInputError(f"a composition has 1 to {MAX_CONCEPTS} concepts, not {len(concepts)}")
    checked = tuple(item if isinstance(item, Concept) else Concept(item) for item in concepts)
    if all(concept.weight < 0 for concept in checked):
        raise InvalidInputError("all concepts are negated; add one with a positive weight: what should happen instead")
    return checked


@dataclass(frozen=True)
class CompositionSpec:
    """What one call composes, validated."""

    concepts: tuple[Concept, ...]
    """Concepts of Eq. 7 to 9."""
    negated: tuple[Concept, ...]
    """Negated concepts of Eq. 8, beside the terms of Eq. 10."""
    joint: str | SemanticGraph
    """Joint text of Eq. 10."""
    lambdas: tuple[float, float, float]
    """Shares of the latent-aware, semantic-aware and joint-text terms."""
    agd: tuple[float, float]
    """Step sizes gamma_attn and gamma_reg of adaptive gradient descent (Eq. 3, 4); (0, 0) switches it off."""
    partial: tuple[bool, ...]
    """For each of `texts` whether it names only a part of what happens (`conditioning.as_partial`).

    Negated concepts always do, as a sentence and its spoken negation say different things. Positive concepts do where
    there are several; a single one is all that happens, so that composing it is generating it. The joint text never
    does.
    """

    @property
    def texts(self) -> list[str | SemanticGraph]:
        """All sentences or graphs: concepts, the joint text if it has a share, negated concepts."""
        joint = [self.joint] if self.lambdas[2] else []
        return [*(concept.text for concept in self.concepts), *joint, *(concept.text for concept in self.negated)]


def validate_composition(concepts: object, method: object, text: Any, lambdas: object, agd: object) -> CompositionSpec:
    """Check everything that says what is composed.

    A negated concept counts by Eq. 8, with its own weight whatever the lambdas; only "semantic" alone negates inside
    the mean of Eq. 9.

    Raises:
        InvalidInputError: see `validate_concepts`; an unknown method, a joint text or shares for another method than
            "fused", shares that are no three numbers from 0 to 1 with sum 1, weights that Eq. 9 cannot divide by, or
            step sizes that are no two numbers from 0 to 1.
    """
    if not isinstance(method, str) or (method not in METHODS and method != PARTS):
        known = ", ".join((AUTO, *METHODS, PARTS))
        raise InvalidInputError(f"method must be one of {known}, not {short_repr(method)}")
    if method == PARTS:
        raise InvalidInputError(f"method {PARTS!r} samples each concept alone, and has no energy; take another method")
    checked = validate_concepts(concepts)
    wanted = checked if method == "semantic" else tuple(concept for concept in checked if concept.weight > 0)
    negated = () if method == "semantic" else tuple(concept for concept in checked if concept.weight < 0)
    shares = validate_lambdas(method, lambdas, text, wanted)
    joint = joint_caption(checked) if text is None else text
    if not isinstance(joint, SemanticGraph):
        check_caption(joint)
    several = len({concept.text for concept in checked if concept.weight > 0}) > 1
    partial = (
        *(several or concept.weight < 0 for concept in wanted),
        *([False] if shares[2] else []),
        *(True for _ in negated),
    )
    return CompositionSpec(wanted, negated, joint, shares, _validate_step_sizes(agd), partial)


def _short(values: object) -> str:
    """Describe a value for a message, and the numbers of a short list or tuple."""
    if isinstance(values, list | tuple) and len(values) <= 4:
        return f"({', '.join(short_repr(value) for value in values)})"
    return short_repr(values)


def _validate_step_sizes(agd: object) -> tuple[float, float]:
    if agd is None:
        return 0.0, 0.0
    wrong = f"agd must be two step sizes from 0 to {MAX_STEP_SIZE:g}, like (0.0004, 0.0004), not {_short(agd)}"
    if not isinstance(agd, list | tuple) or len(agd) != 2:
        raise InvalidInputError(wrong)
    for value in agd:
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= MAX_STEP_SIZE:
            raise InvalidInputError(wrong)
    attention, regularisation = (float(value) for value in agd)
    return attention, regularisation


def validate_lambdas(
    method: str, lambdas: object, text: object, concepts: Sequence[Concept]
) -> tuple[float, float, float]:
    """Check the shares of the latent-aware, semantic-aware and joint-text terms.

    Raises:
        InvalidInputError: see `validate_composition`.
    """
    for name, value in (("lambdas", lambdas), ("text", text)):
        if value is not None and method != "fused":
            raise InvalidInputError(f"{name} is for method 'fused'; method {short_repr(method)} has none")
    shares = {"latent": (1.0, 0.0, 0.0), "semantic": (0.0, 1.0, 0.0), "fused": _validate_shares(lambdas)}[method]
    if shares[1]:
        _check_sum([concept.weight for concept in concepts])
    return shares


def _check_sum(weights: Sequence[float]) -> None:
    """Refuse weights whose sum Eq. 9 cannot divide by: near 0, or so small that shares of either sign grow large.

    Raises:
        InvalidInputError: naming both sums.
    """
    total, size = sum(weights), sum(map(abs, weights))
    if total < MIN_SUM or size > MAX_RATIO * total:
        raise InvalidInputError(
            f"the weights of concepts and their edges sum to {total:g} and their sizes to {size:g}; the semantic-aware "
            f"term divides by the sum, which must be at least {MIN_SUM:g} and a {MAX_RATIO:g}th of the sizes: make the "
            "negations weaker or the rest stronger, bring edges nearer to 1, or use another method"
        )


def _validate_shares(lambdas: object) -> tuple[float, float, float]:
    if lambdas is None:
        return DEFAULT_LAMBDAS
    wrong = f"lambdas must be three numbers from 0 to 1 that sum to 1, not {_short(lambdas)}"
    if not isinstance(lambdas, list | tuple) or len(lambdas) != 3:
        raise InvalidInputError(wrong)
    for value in lambdas:
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
            raise InvalidInputError(wrong)
    if abs(sum(lambdas) - 1.0) > 1e-6:
        raise InvalidInputError(f"{wrong}, which sums to {sum(lambdas):g}")
    latent, semantic, joint = (float(value) for value in lambdas)
    return latent, semantic, joint


def joint_caption(concepts: Sequence[Concept]) -> str | SemanticGraph:
    """Join all positive concepts to one sentence; a single one stands for itself, with its edits.

    Negated concepts are not named: the models never saw a negation in a caption.
    """
    positive = [concept for concept in concepts if concept.weight > 0]
    captions = list(dict.fromkeys(concept.caption.strip().rstrip(".!;, ") for concept in positive))
    if len(captions) == 1:
        return positive[0].text
    return " while ".join(captions)


@dataclass(frozen=True)
class SamplingPlan:
    """The graphs that one clip is sampled from, and the weights of their noise predictions.

    Raises:
        InvalidInputError: more than `limits.MAX_ROWS` graphs.
    """

    graphs: tuple[SemanticGraph, ...]
    """Without edge weights, in the order of the weights."""
    weights: CompositionWeights
    length_from: tuple[int, ...]
    """Indices of the graphs whose sentences tell the length of the clip."""
    partial: tuple[bool, ...]
    """For each graph whether its caption names only a part of what happens (`conditioning.as_partial`)."""

    def __post_init__(self) -> None:
        if len(self.graphs) > MAX_ROWS:
            raise InvalidInputError(
                f"the weights on edges expand this request to {len(self.graphs)} graphs, and {MAX_ROWS} at most share "
                "a run; give fewer edges a weight other than 1, or compose fewer concepts"
            )

    @property
    def is_plain(self) -> bool:
        """Whether plain guidance is all there is to it (Eq. A): one graph without weighted edges."""
        return self.weights == CompositionWeights((1.0,))

    @staticmethod
    def for_graph(graph: SemanticGraph, negated: Sequence[SemanticGraph] = ()) -> SamplingPlan:
        """Plan for one graph: one term, or more where its edges are weighted or actions must not happen.

        Args:
            graph: what should happen.
            negated: what must not; each counts with `SPOKEN_NEGATION_WEIGHT` (EnergyMoGen, Eq. 8), and names only a
                part of what could happen.

        Raises:
            InvalidGraphError: every action has weight 0.
        """
        graphs, coefficients = zip(*weighted_edge_terms(graph), strict=True)
        negations = [
            (term, SPOKEN_NEGATION_WEIGHT * coefficient)
            for unwanted in negated
            for term, coefficient in weighted_edge_terms(unwanted)
        ]
        weights = CompositionWeights(coefficients, negated=tuple(weight for _, weight in negations))
        partial = (*(False for _ in graphs), *(True for _ in negations))
        return SamplingPlan((*graphs, *(term for term, _ in negations)), weights, (0,), partial)

    @staticmethod
    def for_composition(spec: CompositionSpec, graphs: Sequence[SemanticGraph]) -> SamplingPlan:
        """Plan for a composition; the concepts that should happen tell the length.

        Args:
            spec: what is composed.
            graphs: of its `texts`.

        Raises:
            InvalidGraphError: every action of a graph has weight 0.
            InvalidInputError: with edge weights, the weights of the concepts no longer have a sum to divide by.
        """
        terms = [weighted_edge_terms(graph) for graph in graphs]
        first_negated = len(graphs) - len(spec.negated)
        joint_weights = [1.0] * (first_negated - len(spec.concepts))
        part_weights = [
            *(concept.weight for concept in spec.concepts),
            *joint_weights,
            *(concept.weight for concept in spec.negated),
        ]
        scaled = [
            [weight * coefficient for _, coefficient in part] for weight, part in zip(part_weights, terms, strict=True)
        ]
        concepts, joint, negated = (
            tuple(chain.from_iterable(parts))
            for parts in (
                scaled[: len(spec.concepts)],
                scaled[len(spec.concepts) : first_negated],
                scaled[first_negated:],
            )
        )
        first_terms = accumulate((len(part) for part in terms), initial=0)
        length_from = tuple(
            index for index, concept in zip(first_terms, spec.concepts, strict=False) if concept.weight > 0
        )
        all_graphs = tuple(graph for part in terms for graph, _ in part)
        # The terms of weighted edges follow their graph.
        partial = tuple(is_part for is_part, part in zip(spec.partial, terms, strict=True) for _ in part)
        weights = CompositionWeights(concepts, joint, negated, spec.lambdas, spec.agd)
        plan = SamplingPlan(all_graphs, weights, length_from, partial)
        if spec.lambdas[1]:
            _check_sum(concepts)  # weighted edges change the sum
        return plan


def weighted_edge_terms(graph: SemanticGraph) -> list[tuple[SemanticGraph, float]]:
    """Expand a weighted graph into unweighted graphs plus the coefficients that recombine their noise predictions.

    Each weight w_e scales what the model predicts because of the node that edge e leads to, at every step of every
    level:

        eps(G, w) = eps(G') + sum_e (c(w_e) - 1) (eps(G') - eps(G' without e))

    G' is G without the nodes of weight 0; c(w) = w up to 1, and 1 + (w - 1) UPWEIGHT_GAIN beyond. This is EnergyMoGen's
    latent-aware composition (Eq. 7, 8) of a graph and the same graph without a node. Coefficients sum to 1, except
    where the only action is weighted: nothing is left without it, so it counts against no text at all.

    Raises:
        InvalidGraphError: every action has weight 0.
    """
    while (absent := next((n for n, node in enumerate(graph.nodes, start=1) if node.weight == 0), None)) is not None:
        graph = without(graph, absent)
    plain = graph
    changes = {number: node.weight - 1.0 for number, node in enumerate(graph.nodes, start=1) if node.weight != 1}
    changes = {number: change * (UPWEIGHT_GAIN if change > 0 else 1.0) for number, change in changes.items()}
    for number in changes:
        plain = with_weight(plain, number, 1.0)
    terms = [(plain, 1.0 + sum(changes.values()))]
    for number, change in changes.items():
        if not number == 1 == len(plain.actions):
            terms.append((without(plain, number), -change))
    return terms
