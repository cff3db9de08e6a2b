"""What a composition is made of, checked before any model runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from numbers import Real
from typing import Any, Final

from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.edits import with_weight, without
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.limits import MAX_CONCEPTS
from kinegraph.text.parser import check_caption

METHODS: Final = ("latent", "semantic", "fused")
DEFAULT_LAMBDAS: Final = (0.0, 0.1, 0.9)
"""Latent-aware, semantic-aware, joint text. EnergyMoGen (section 4.1) has 0.1, 0.7, 0.2; on 12 pairs that training
never joined both actions happen in 98 % of 120 clips with these, in 54 % with those, in 98 % by the joint text alone
(`kinegraph_benchmarks.quality.composition_settings`).
"""
NEGATION_WEIGHT: Final = -1.0
"""Default weight of what must not happen: where a sentence names two actions it takes .92 of the clips of one and
.08 of the other's; -0.5 takes .15. It also takes what the unwanted has in common with the wanted: "not runs" leaves
.20 of the walks, and at -0.3 .95 (`kinegraph_benchmarks.quality.composition_settings`)."""
MAX_STEP_SIZE: Final = 1.0
"""Of adaptive gradient descent. At 0.1 EnergyMoGen's motions are spoilt (Table 9) and the default bundle's are nearest
to captured ones (`kinegraph_benchmarks.quality.composition_settings`)."""
MAX_WEIGHT: Final = 10.0
MIN_SUM: Final = 0.05
MAX_RATIO: Final = 5.0
"""Eq. 9 divides by the sum of the weights: a small or negative one flips or inflates every sign."""


@dataclass(frozen=True)
class Concept:
    """One motion of a composition.

    Raises:
        InvalidInputError: no text and no graph, or a weight that is 0, not finite, or beyond 10.
    """

    text: str | SemanticGraph
    """A sentence, or its graph."""
    weight: float = 1.0
    """How much of it; negative for what must not happen."""

    def __post_init__(self) -> None:
        if not isinstance(self.text, SemanticGraph):
            check_caption(self.text)
        weight = self.weight
        if isinstance(weight, bool) or not isinstance(weight, Real) or not math.isfinite(weight):
            raise InvalidInputError(f"the weight of a concept must be a finite number, not {weight!r}")
        if weight == 0 or abs(weight) > MAX_WEIGHT:
            raise InvalidInputError(
                f"the weight of a concept must be -{MAX_WEIGHT:g} to {MAX_WEIGHT:g} and not 0, not {weight:g}; "
                "leave out what counts for nothing"
            )

    @property
    def caption(self) -> str:
        """Its sentence."""
        return self.text.caption if isinstance(self.text, SemanticGraph) else self.text


def validate_concepts(concepts: object) -> tuple[Concept, ...]:
    """A list of concepts; plain sentences and graphs count with weight 1.

    Raises:
        InvalidInputError: none, too many, or only negations.
    """
    if isinstance(concepts, str | SemanticGraph | Concept) or not isinstance(concepts, Sequence):
        raise InvalidInputError("concepts must be a list of Concept(text, weight)")
    if not 1 <= len(concepts) <= MAX_CONCEPTS:
        raise InvalidInputError(f"a composition has 1 to {MAX_CONCEPTS} concepts, not {len(concepts)}")
    found = tuple(item if isinstance(item, Concept) else Concept(item) for item in concepts)
    if all(concept.weight < 0 for concept in found):
        raise InvalidInputError("all concepts are negated; add one with a positive weight: what should happen instead")
    return found


@dataclass(frozen=True)
class CompositionSpec:
    """What one call composes."""

    concepts: tuple[Concept, ...]
    """Of the terms of Eq. 7 to 9."""
    negated: tuple[Concept, ...]
    """Of Eq. 8, beside the terms of Eq. 10."""
    joint: str | SemanticGraph
    lambdas: tuple[float, float, float]
    """Shares of the latent-aware, semantic-aware and joint-text terms."""
    agd: tuple[float, float]
    """Step sizes gamma_attn and gamma_reg; 0, 0 is without adaptive gradient descent."""

    @property
    def parts(self) -> list[tuple[str | SemanticGraph, float]]:
        """Sentences or graphs with their weights, in the order of a `CompositionWeights`."""
        joint = [(self.joint, 1.0)] if self.lambdas[2] else []
        around = ([(concept.text, concept.weight) for concept in group] for group in (self.concepts, self.negated))
        return [*next(around), *joint, *next(around)]

    def mixture(self, shares: Sequence[Sequence[float]]) -> CompositionWeights:
        """Weights of the graphs that stand for each part (`edits.weighted_edge_terms`), given their shares of it."""
        weights = [tuple(weight * share for share in own) for (_, weight), own in zip(self.parts, shares, strict=True)]
        first, last = len(self.concepts), len(weights) - len(self.negated)
        slices = (slice(first), slice(first, last), slice(last, None))
        concepts, joint, negated = (tuple(chain.from_iterable(weights[part])) for part in slices)
        return CompositionWeights(concepts, joint, negated, self.lambdas, self.agd)


def validate_composition(concepts: object, method: object, text: Any, lambdas: object, agd: object) -> CompositionSpec:
    """All that says what is composed.

    A negated concept counts by Eq. 8, with its own weight whatever the lambdas; only "semantic" alone negates inside
    the mean of Eq. 9.

    Raises:
        InvalidInputError: see `validate_concepts`; an unknown method, a joint text or shares for another method than
            "fused", shares that are no three numbers from 0 to 1 with sum 1, weights that Eq. 9 cannot divide by, or
            step sizes that are no two numbers from 0 to 1.
    """
    found = validate_concepts(concepts)
    wanted = found if method == "semantic" else tuple(concept for concept in found if concept.weight > 0)
    negated = () if method == "semantic" else tuple(concept for concept in found if concept.weight < 0)
    shares = validate_lambdas(method, lambdas, text, wanted)
    joint = joint_caption(found) if text is None else text
    if not isinstance(joint, SemanticGraph):
        check_caption(joint)
    return CompositionSpec(wanted, negated, joint, shares, _step_sizes(agd))


def _step_sizes(agd: object) -> tuple[float, float]:
    if agd is None:
        return 0.0, 0.0
    wrong = f"agd must be two step sizes from 0 to {MAX_STEP_SIZE:g}, like (0.0004, 0.0004), not {agd!r}"
    if not isinstance(agd, list | tuple) or len(agd) != 2:
        raise InvalidInputError(wrong)
    for value in agd:
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= MAX_STEP_SIZE:
            raise InvalidInputError(wrong)
    attention, regularisation = (float(value) for value in agd)
    return attention, regularisation


def validate_lambdas(
    method: object, lambdas: object, text: object, concepts: Sequence[Concept]
) -> tuple[float, float, float]:
    """Shares of the latent-aware, semantic-aware and joint-text terms; raises as `validate_composition`."""
    if method not in METHODS:
        raise InvalidInputError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    for name, value in (("lambdas", lambdas), ("text", text)):
        if value is not None and method != "fused":
            raise InvalidInputError(f"{name} is for method 'fused'; method {method!r} has none")
    shares = {"latent": (1.0, 0.0, 0.0), "semantic": (0.0, 1.0, 0.0), "fused": _shares(lambdas)}[str(method)]
    if shares[1]:
        total = sum(concept.weight for concept in concepts)
        size = sum(abs(concept.weight) for concept in concepts)
        if total < MIN_SUM or size > MAX_RATIO * total:
            raise InvalidInputError(
                f"the weights sum to {total:g} and their sizes to {size:g}; the semantic-aware term divides by the "
                f"sum, which must be at least {MIN_SUM:g} and a {MAX_RATIO:g}th of the sizes: make the negations "
                "weaker or the rest stronger, or use another method"
            )
    return shares


def _shares(lambdas: object) -> tuple[float, float, float]:
    if lambdas is None:
        return DEFAULT_LAMBDAS
    wrong = f"lambdas must be three numbers from 0 to 1 that sum to 1, not {lambdas!r}"
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
    """One sentence for all that should happen; a single positive concept speaks for itself, edits included.

    The models never saw a negation in a caption, so negated concepts are not named.
    """
    positive = [concept for concept in concepts if concept.weight > 0]
    captions = list(dict.fromkeys(concept.caption.strip().rstrip(".!;, ") for concept in positive))
    if len(captions) == 1:
        return positive[0].text
    return " while ".join(captions)


UPWEIGHT_GAIN: Final = 0.4
"""What a weight counts beyond 1: at twice a node's own prediction and more, motions leave what a model knows, and a
turn or a speed falls again (`kinegraph_benchmarks.quality.edit_curves`)."""


def weighted_edge_terms(graph: SemanticGraph) -> list[tuple[SemanticGraph, float]]:
    """Graphs whose edges all weigh 1, with the coefficients by which their predictions make up that of `graph`.

    Each weight w_e scales what the model predicts because of that node, at every step of every level:

        eps(G, w) = eps(G') + sum_e (c(w_e) - 1) (eps(G') - eps(G' without e))

    G' is G without the nodes of weight 0; c(w) = w up to 1, and 1 + (w - 1) STRENGTHENING beyond. This is EnergyMoGen's
    latent-aware composition (Eq. 7, 8) of a graph and the same graph without a node. Coefficients sum to 1, but for a
    weight on the only action: nothing is left without it, so it counts against no text at all.

    Raises:
        InvalidGraphError: every action has weight 0.
    """
    while (absent := next((n for n, node in enumerate(graph.nodes, start=1) if node.weight == 0), None)) is not None:
        graph = without(graph, absent)
    plain = graph
    turned = {number: node.weight - 1.0 for number, node in enumerate(graph.nodes, start=1) if node.weight != 1}
    turned = {number: more * (UPWEIGHT_GAIN if more > 0 else 1.0) for number, more in turned.items()}
    for number in turned:
        plain = with_weight(plain, number, 1.0)
    terms = [(plain, 1.0 + sum(turned.values()))]
    for number, more in turned.items():
        if not number == 1 == len(plain.actions):
            terms.append((without(plain, number), -more))
    return terms
