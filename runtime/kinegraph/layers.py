"""Concepts over a span of a timeline: each sentence that a span touches is composed with its concept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from kinegraph.concepts import Concept
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.limits import MAX_CONCEPTS
from kinegraph.validation import finite_number, short_repr

TOUCHES: Final = 0.1
"""Seconds: a sentence that a span covers for less is not touched by it."""
EXACT: Final = 0.05
"""Seconds by which a span may differ from the sentences that it counts for, without a word about it."""
MAX_LAYERS: Final = 64
"""Layers of one timeline."""


@dataclass(frozen=True)
class Layer:
    """A concept that counts over a span of a timeline, beside its sentences.

    A sentence is sampled at once, so a layer counts for the whole of every sentence that it touches; the clip's notes
    say where that is more or less than its span.

    Raises:
        InvalidInputError: as in `concepts.Concept`; no span, or one that ends before it begins.
    """

    text: str | SemanticGraph
    """A sentence, or its graph."""
    begin: float
    """Seconds of the whole timeline."""
    end: float
    weight: float = 1.0
    """Of the concept (`concepts.Concept`); negative for what must not happen."""

    def __post_init__(self) -> None:
        Concept(self.text, self.weight)
        begin, end = finite_number(self.begin), finite_number(self.end)
        if begin is None or end is None or not 0 <= begin < end:
            raise InvalidInputError(
                "a layer begins at 0 s or later, and ends after that, not "
                f"{short_repr(self.begin)} to {short_repr(self.end)}"
            )

    @property
    def concept(self) -> Concept:
        """The concept that counts."""
        return Concept(self.text, self.weight)

    def touches(self, begin: float, end: float) -> bool:
        """Tell whether it counts for a sentence from `begin` to `end`; a short one for where most of it is."""
        covered = min(self.end, end) - max(self.begin, begin)
        return covered >= min(TOUCHES, (self.end - self.begin) / 2) - 1e-9


def check_layers(layers: object, ends: Sequence[float]) -> tuple[Layer, ...]:
    """Check layers against the sentences of a timeline.

    Args:
        layers: list or tuple of them.
        ends: where each sentence ends, seconds.

    Returns:
        The layers, none longer than the timeline.

    Raises:
        InvalidInputError: no layers, too many, one that begins behind the end, or more concepts on one sentence than
            `limits.MAX_CONCEPTS`.
    """
    if not isinstance(layers, list | tuple) or not all(isinstance(layer, Layer) for layer in layers):
        raise InvalidInputError(f"layers is a list of Layer, not {short_repr(layers)}")
    if len(layers) > MAX_LAYERS:
        raise InvalidInputError(f"a timeline has at most {MAX_LAYERS} layers, not {len(layers)}")
    for index, layer in enumerate(layers):
        if layer.begin >= ends[-1]:
            raise InvalidInputError(f"layers[{index}] begins at {layer.begin:g} s, behind the end at {ends[-1]:g} s")
    clipped = tuple(replace(layer, end=min(layer.end, ends[-1])) for layer in layers)
    for index, (begin, end) in enumerate(spans_of(ends)):
        count = sum(layer.touches(begin, end) for layer in clipped)
        if count >= MAX_CONCEPTS:
            raise InvalidInputError(
                f"{count} layers touch sentence {index + 1}; with the sentence {MAX_CONCEPTS} concepts go together"
            )
    return clipped


def spans_of(ends: Sequence[float]) -> list[tuple[float, float]]:
    """Pair where sentences begin and end, seconds."""
    return list(zip((0.0, *ends[:-1]), ends, strict=True))


def notes_of(layers: Sequence[Layer], ends: Sequence[float]) -> tuple[str, ...]:
    """Say of each layer that counts for more or less than its span, for what it counts."""
    found = []
    for layer in layers:
        touched = [span for span in spans_of(ends) if layer.touches(*span)]
        begin, end = touched[0][0], touched[-1][1]
        if abs(begin - layer.begin) > EXACT or abs(end - layer.end) > EXACT:
            found.append(
                f'"{layer.concept.caption}" counts from {begin:g} to {end:g} s, the whole of the sentences that its '
                f"span from {layer.begin:g} to {layer.end:g} s touches"
            )
    return tuple(found)
