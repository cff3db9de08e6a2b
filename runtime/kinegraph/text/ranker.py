"""A linear model that ranks and types the spans of an action, and the best set of spans that do not overlap."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.errors import BundleFormatError
from kinegraph.text.features import pair_features, span_features
from kinegraph.text.roles import ARGUMENT_ROLES
from kinegraph.text.spans import Span, Words, phrases

FloatArray = NDArray[np.float32]

CLASSES: Final = len(ARGUMENT_ROLES) + 1
"""No argument, then `ARGUMENT_ROLES` in order."""


@dataclass(frozen=True)
class Candidates:
    """Spans of one action with the names of their features."""

    spans: list[tuple[int, int, int]]
    """First word, last word, head."""
    features: list[list[str]]


@dataclass(frozen=True)
class Choice:
    """What the model makes of one action's spans."""

    taken: list[tuple[str, Span]]
    ranked: list[tuple[str, Span]]
    """All of them with the role each would have, the likeliest first."""


def candidates(
    words: Words, verbs: Sequence[int], rules: Sequence[Mapping[Span, str]], voices: Sequence[str]
) -> list[Candidates]:
    """What may be an argument of each action.

    Args:
        words: the caption.
        verbs: word of each action.
        rules: per action, what the rules take for its arguments.
        voices: per action "act" or "pass".
    """
    known = {(first, last): anchor for first, last, anchor in phrases(words)}
    for found in rules:
        for first, last in found:
            known.setdefault((first, last), _top(words, first, last))
    spans = [(first, last, anchor) for (first, last), anchor in known.items()]
    alone = [span_features(words, *span) for span in spans]
    made = []
    for verb, found, voice in zip(verbs, rules, voices, strict=True):
        own = [
            (span, names)
            for span, names in zip(spans, alone, strict=True)
            if not span[0] <= verb <= span[1] and words.sentence[span[0]] == words.sentence[verb]
        ]
        others = {span: role for other in rules if other is not found for span, role in other.items()}
        features = [names + pair_features(words, verb, span, found, others, verbs, voice) for span, names in own]
        made.append(Candidates([span for span, _ in own], features))
    return made


def _top(words: Words, first: int, last: int) -> int:
    """The word of a span that depends on a word outside."""
    for place in range(first, last + 1):
        if not first <= words.head[place] <= last or words.head[place] == place:
            return place
    return last


def _arrays(data: bytes) -> dict[str, NDArray[Any]]:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in ("names", "weights", "provenance")}
    except (
        OSError,
        ValueError,
        KeyError,
        EOFError,
        TypeError,
        AttributeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise BundleFormatError(f"arguments.npz does not hold the weights of arguments: {error}") from error
    if arrays["names"].dtype != np.uint8 or arrays["weights"].dtype != np.float16:
        raise BundleFormatError("arguments.npz must hold names as bytes and weights as float16")
    return arrays


class ArgumentRanker:
    """Multinomial logistic regression over named features.

    Args:
        data: an `.npz` with `names`, n lines of UTF-8 as bytes, and `weights` (n, CLASSES) float16.

    Raises:
        BundleFormatError: the bytes are no such file.
    """

    def __init__(self, data: bytes) -> None:
        stored = _arrays(data)
        names = stored["names"].tobytes().decode("utf-8", errors="replace").split("\n")
        weights = stored["weights"].astype(np.float32)
        if weights.shape != (len(names), CLASSES):
            raise BundleFormatError(
                f"arguments.npz holds {len(names)} names and weights {weights.shape}, not ({len(names)}, {CLASSES})"
            )
        if not np.isfinite(weights).all():
            raise BundleFormatError("arguments.npz holds weights that are not finite")
        self._index: dict[str, int] = {name: place for place, name in enumerate(names)}
        self._weights: FloatArray = weights

    def scores(self, features: Sequence[Sequence[str]]) -> FloatArray:
        """(spans, CLASSES) sums of the weights of their features; unknown features count nothing."""
        rows = [[self._index[name] for name in names if name in self._index] for names in features]
        flat = np.array([place for row in rows for place in row], dtype=np.int64)
        owner = np.repeat(np.arange(len(rows)), [len(row) for row in rows])
        scores = np.zeros((len(rows), CLASSES), dtype=np.float32)
        np.add.at(scores, owner, self._weights[flat])
        return scores

    def choose(self, found: Candidates) -> Choice:
        """The arguments: the set of spans without overlap whose log-odds against being none add up to most."""
        if not found.spans:
            return Choice([], [])
        scores = self.scores(found.features)
        roles = scores[:, 1:].argmax(axis=1)
        # against all roles together: one that is torn between two of them is an argument all the same
        gains = np.logaddexp.reduce(scores[:, 1:], axis=1) - scores[:, 0]
        named = [(ARGUMENT_ROLES[role], span[:2]) for role, span in zip(roles, found.spans, strict=True)]
        chosen = heaviest(found.spans, gains.tolist())
        order = np.argsort(-gains, kind="stable")
        return Choice([named[place] for place in chosen], [named[place] for place in order])


def heaviest(spans: Sequence[tuple[int, ...]], gains: Sequence[float]) -> list[int]:
    """Weighted interval scheduling: which spans that do not overlap gain most together (Kleinberg and Tardos, 6.1).

    Args:
        spans: first and last word of each.
        gains: of each; those that are not positive are never taken.
    """
    order = sorted((place for place, gain in enumerate(gains) if gain > 0), key=lambda place: spans[place][1])
    ends = [spans[place][1] for place in order]
    totals = [0.0]
    taken: list[bool] = []
    earlier: list[int] = []
    for rank, place in enumerate(order):
        before = rank
        while before and ends[before - 1] >= spans[place][0]:
            before -= 1
        earlier.append(before)
        total = totals[before] + gains[place]
        taken.append(total > totals[rank])
        totals.append(max(total, totals[rank]))
    chosen = []
    rank = len(order)
    while rank:
        if taken[rank - 1]:
            chosen.append(order[rank - 1])
            rank = earlier[rank - 1]
        else:
            rank -= 1
    return sorted(chosen, key=lambda place: spans[place][0])


def packed(names: Sequence[str], weights: FloatArray, provenance: str) -> bytes:
    """The content of `arguments.npz`; the same input gives the same bytes. `provenance` says what it was trained on."""
    buffer = io.BytesIO()
    lines = np.frombuffer("\n".join(names).encode("utf-8"), dtype=np.uint8)
    source = np.frombuffer(provenance.encode("utf-8"), dtype=np.uint8)
    np.savez_compressed(buffer, names=lines, weights=weights.astype(np.float16), provenance=source)
    return buffer.getvalue()


def provenance_of(data: bytes) -> str:
    """What the weights in an `arguments.npz` were trained on.

    Raises:
        BundleFormatError: the bytes are no such file.
    """
    return _arrays(data)["provenance"].tobytes().decode("utf-8")
