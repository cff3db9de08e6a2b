"""Argument classifier: multinomial logistic regression that selects and types the arguments of an action.

Every candidate span of an action gets named features, the classifier sums their weights per role, and weighted interval
scheduling selects the best set of spans that do not overlap.

Most features are those of Gildea and Jurafsky, "Automatic Labeling of Semantic Roles", Computational Linguistics 2002:
head word, phrase type, path in the parse, position, voice. The preposition with its object is as in Xue and Palmer,
"Calibrating Features for Semantic Role Labeling", EMNLP 2004. Names of features that hold a content word begin with an
asterisk, because training shows every example a second time without them. Trained weights depend on the names.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.archives import UNREADABLE, read_arrays
from kinegraph.arrays import FloatArray
from kinegraph.errors import BundleFormatError
from kinegraph.graph import ARGUMENT_ROLES
from kinegraph.text import lexicon
from kinegraph.text.dependency import ParsedTokens, Span, has_word

CLASSES: Final = len(ARGUMENT_ROLES) + 1
"""No argument (class 0), then `ARGUMENT_ROLES` in order."""

_LIMITS: Final = {"names": 1 << 24, "weights": 1 << 24, "provenance": 1 << 16}
"""Most bytes of each array of `arguments.npz`, unpacked; thirty times those of 20,000 names."""

_MAX_TEXT_TOKENS: Final = 4
"""Longest span whose text is a feature."""
_MAX_PATH_LABELS: Final = 4
"""Longest path in the parse that is a feature."""
_ANCHOR_POS: Final = frozenset("NOUN PROPN PRON ADP ADV VERB ADJ NUM SCONJ PART AUX X INTJ".split())
_NON_ANCHOR_DEPS: Final = frozenset("det punct cc aux auxpass case preconj".split())


@dataclass(frozen=True)
class ArgumentCandidates:
    """Candidate spans of one action with the names of their features."""

    spans: list[tuple[int, int, int]]
    """First token, last token, head of the span."""
    features: list[list[str]]
    """Names per span."""


@dataclass(frozen=True)
class ArgumentChoice:
    """Arguments that the classifier selects for one action, as (role, span)."""

    chosen: list[tuple[str, Span]]
    """Arguments, which do not overlap, from left to right."""
    ranked: list[tuple[str, Span]]
    """All candidates with the likeliest role of each, the likeliest argument first."""


class ArgumentClassifier:
    """Multinomial logistic regression over named features.

    Args:
        data: an `.npz` with `names`, n lines of UTF-8 as bytes, and `weights` (n, CLASSES) float16.

    Raises:
        BundleFormatError: the bytes are no such file.
    """

    def __init__(self, data: bytes) -> None:
        stored = _read_arrays(data)
        text, weights = stored["names"].tobytes(), stored["weights"].astype(np.float32)
        count = text.count(b"\n") + 1
        if weights.shape != (count, CLASSES):
            raise BundleFormatError(
                f"arguments.npz holds {count} names and weights {weights.shape}, not ({count}, {CLASSES})"
            )
        names = text.decode("utf-8", errors="replace").split("\n")
        if not np.isfinite(weights).all():
            raise BundleFormatError("arguments.npz holds weights that are not finite")
        self._index: dict[str, int] = {name: index for index, name in enumerate(names)}
        self._weights: FloatArray = weights

    def scores(self, features: Sequence[Sequence[str]]) -> FloatArray:
        """Sum the weights of each span's features, unknown ones left out; returns (spans, CLASSES) logits."""
        look_up = self._index.get
        rows = [[index for index in map(look_up, names) if index is not None] for names in features]
        scores = np.zeros((len(rows), CLASSES), dtype=np.float32)
        flat = np.array([index for row in rows for index in row], dtype=np.int64)
        filled = np.array([number for number, row in enumerate(rows) if row], dtype=np.int64)
        if len(flat):
            starts = np.cumsum([0] + [len(rows[number]) for number in filled[:-1]])
            scores[filled] = np.add.reduceat(self._weights[flat], starts, axis=0)
        return scores

    def choose(self, candidates: ArgumentCandidates) -> ArgumentChoice:
        """Select the set of spans without overlap that maximises the summed log-odds of being an argument."""
        if not candidates.spans:
            return ArgumentChoice([], [])
        scores = self.scores(candidates.features)
        roles = scores[:, 1:].argmax(axis=1)
        # log(P(any role) / P(none)): a span torn between two roles is an argument all the same
        gains = np.logaddexp.reduce(scores[:, 1:], axis=1) - scores[:, 0]
        typed = [(ARGUMENT_ROLES[role], span[:2]) for role, span in zip(roles, candidates.spans, strict=True)]
        chosen = weighted_interval_scheduling(candidates.spans, gains.tolist())
        order = np.argsort(-gains, kind="stable")
        return ArgumentChoice([typed[index] for index in chosen], [typed[index] for index in order])


def weighted_interval_scheduling(spans: Sequence[tuple[int, ...]], gains: Sequence[float]) -> list[int]:
    """Select the spans without overlap whose gains sum to the maximum, by dynamic programming.

    Kleinberg and Tardos, "Algorithm Design", section 6.1: OPT(j) = max(v_j + OPT(p(j)), OPT(j - 1)), where p(j) counts
    the spans that end before span j begins.

    Args:
        spans: first and last token of each, both included.
        gains: v, one for each span; spans without a positive gain are never selected.

    Returns:
        Indices of the selected spans, from left to right.
    """
    order = sorted((index for index, gain in enumerate(gains) if gain > 0), key=lambda index: spans[index][1])
    ends = [spans[index][1] for index in order]
    best = [0.0]  # OPT
    is_taken: list[bool] = []
    compatible: list[int] = []  # p
    for rank, index in enumerate(order):
        before = rank
        while before and ends[before - 1] >= spans[index][0]:
            before -= 1
        compatible.append(before)
        total = best[before] + gains[index]
        is_taken.append(total > best[rank])
        best.append(max(total, best[rank]))
    chosen = []
    rank = len(order)
    while rank:  # trace the optimum back
        if is_taken[rank - 1]:
            chosen.append(order[rank - 1])
            rank = compatible[rank - 1]
        else:
            rank -= 1
    return sorted(chosen, key=lambda index: spans[index][0])


# Candidates and features


def argument_candidates(
    tokens: ParsedTokens, verbs: Sequence[int], rules: Sequence[Mapping[Span, str]], voices: Sequence[str]
) -> list[ArgumentCandidates]:
    """List the candidate spans of each action, in its sentence and without its verb, with their features.

    Args:
        tokens: the caption.
        verbs: token index of each action.
        rules: for each action, its arguments by the rules.
        voices: for each action "act" or "pass".
    """
    anchors = {(first, last): anchor for first, last, anchor in candidate_spans(tokens)}
    for arguments in rules:
        for first, last in arguments:
            anchors.setdefault((first, last), _span_head(tokens, first, last))
    spans = [(first, last, anchor) for (first, last), anchor in anchors.items()]
    contents = [content_word(tokens, *span) for span in spans]
    shared_features = [span_features(tokens, *span, inner) for span, inner in zip(spans, contents, strict=True)]
    candidates = []
    for verb, arguments, voice in zip(verbs, rules, voices, strict=True):
        verb_spans, features = [], []
        others = {span: role for other in rules if other is not arguments for span, role in other.items()}
        action = _Action(verb, arguments, others, verbs, voice)
        for span, names, inner in zip(spans, shared_features, contents, strict=True):
            if not span[0] <= verb <= span[1] and tokens.sentence[span[0]] == tokens.sentence[verb]:
                verb_spans.append(span)
                features.append(names + pair_features(tokens, action, span, inner))
        candidates.append(ArgumentCandidates(verb_spans, features))
    return candidates


def _span_head(tokens: ParsedTokens, first: int, last: int) -> int:
    """Find the token of a span that depends on a token outside."""
    for index in range(first, last + 1):
        if not first <= tokens.head[index] <= last or tokens.head[index] == index:
            return index
    return last


def span_features(tokens: ParsedTokens, first: int, last: int, anchor: int, inner: str) -> list[str]:
    """Name the features of a span that do not depend on the action; `inner` is its `content_word`."""
    text, pos = tokens.text, tokens.pos
    lemma = tokens.lemma[anchor]
    before = text[first - 1] if first else "^"
    behind = text[last + 1] if last + 1 < len(tokens) else "$"
    size = min(last - first + 1, 5)
    names = [
        "bias",
        f"*a:{lemma}",
        f"f:{text[first]}",
        f"*l:{text[last]}",
        f"*fi:{text[first]} {inner}",
        f"*i:{inner}",
        f"d:{tokens.dep[anchor]}",
        f"p:{pos[first]} {pos[anchor]} {pos[last]}",
        f"n:{size}",
        f"np:{pos[last + 1] if last + 1 < len(tokens) else '$'} {pos[last]}",
        f"pp:{pos[first - 1] if first else '^'} {pos[first]}",
        f"b:{before}",
        f"e:{behind}",
        f"k:{_subtree_overhang(tokens, first, last, anchor)} {pos[anchor]}",
    ]
    if size <= _MAX_TEXT_TOKENS:
        names.append("*t:" + " ".join(text[first : last + 1]))
    return names


def content_word(tokens: ParsedTokens, first: int, last: int, anchor: int) -> str:
    """Find the lemma of a preposition's object or a clause's verb in a span; for other heads, of the head itself."""
    if tokens.pos[anchor] in ("ADP", "SCONJ"):
        for index in range(anchor + 1, last + 1):
            if tokens.head[index] == anchor or tokens.dep[index] in ("pobj", "pcomp"):
                return tokens.lemma[index]
    return tokens.lemma[anchor]


def _subtree_overhang(tokens: ParsedTokens, first: int, last: int, anchor: int) -> str:
    """Compare the span with the subtree of its head at both ends.

    "<" if the subtree reaches beyond the span, "=" if both end there, ">" if the span reaches beyond the subtree.
    """
    left = "<" if tokens.first[anchor] < first else ("=" if tokens.first[anchor] == first else ">")
    right = "<" if tokens.last[anchor] > last else ("=" if tokens.last[anchor] == last else ">")
    return left + right


@dataclass(frozen=True)
class _Action:
    """An action whose arguments are looked for."""

    verb: int
    """Token index."""
    rules: Mapping[Span, str]
    """Its arguments by the rules."""
    others: Mapping[Span, str]
    """Arguments of the other actions by the rules."""
    verbs: Sequence[int]
    """Token indices of all actions."""
    voice: str
    """"act" or "pass"."""
    paths: dict[int, str] = field(default_factory=dict)
    """Path in the parse from each head of a span, as far as it was needed."""

    def path(self, tokens: ParsedTokens, anchor: int) -> str:
        """Return the path from the head of a span to the verb."""
        path = self.paths.get(anchor)
        if path is None:
            path = self.paths[anchor] = _dependency_path(tokens, self.verb, anchor)
        return path


def pair_features(tokens: ParsedTokens, action: _Action, span: tuple[int, int, int], inner: str) -> list[str]:
    """Name the features of a span as an argument of an action.

    Args:
        tokens: the caption.
        action: the action.
        span: first and last token, and the head of the span.
        inner: its `content_word`.
    """
    first, last, anchor = span
    verb, verbs, others, voice = action.verb, action.verbs, action.others, action.voice
    word, lemma = tokens.text[first], tokens.lemma[verb]
    side = "L" if last < verb else "R"
    rule = action.rules.get((first, last)) or _relation_to_rules(first, last, action.rules)
    between = sum([min(last, verb) < other < max(first, verb) for other in verbs])
    within = sum([first <= other <= last for other in verbs])
    path = action.path(tokens, anchor)
    distance = min(abs(first - verb) if side == "R" else abs(verb - last), 6)
    group = _verb_group(lemma)
    return [
        f"r:{rule}",
        f"r:{rule} {tokens.pos[anchor]}",
        f"r:{rule} {word}",
        f"*r:{rule} {lemma}",
        f"q:{rule} {others.get((first, last), '')}",
        f"q:{side} {between} {others.get((first, last), '')}",
        f"s:{side} {path}",
        f"s:{side} {path} {tokens.pos[first]}",
        f"s:{side} {between} {within}",
        f"s:{side} {between} {word}",
        f"x:{side} {last + 1 in verbs} {word}",
        f"s:{side} {distance} {tokens.pos[anchor]}",
        *(f"*v:{lemma} {value}" for value in (side, path, word, inner, f"{word} {inner}")),
        f"g:{group} {voice} {side} {tokens.dep[anchor]}",
        f"g:{group} {word}",
        f"o:{voice} {side} {path}",
        f"h:{tokens.tag[verb]} {tokens.dep[verb]} {side} {tokens.pos[anchor]}",
    ]


def _verb_group(lemma: str) -> str:
    for name, group in (
        ("happens", lexicon.UNACCUSATIVE),
        ("state", lexicon.STATIVE),
        ("travel", lexicon.TRAVEL),
        ("transfer", lexicon.TRANSFER),
    ):
        if lemma in group:
            return name
    return "other"


def _relation_to_rules(first: int, last: int, rules: Mapping[Span, str]) -> str:
    """Describe how a span overlaps the arguments of the rules.

    Kinds are "in" (inside an argument), "over" (around one), "x" (crossing one) and "none"; "<" and ">" mark a common
    first or last token. The first argument around the span decides, else the last that overlaps.
    """
    relation = "none"
    for (left, right), role in rules.items():
        if left <= last and first <= right:
            kind = "in" if left <= first and last <= right else ("over" if first <= left and right <= last else "x")
            ends = ("<" if left == first else "") + (">" if right == last else "")
            relation = f"{kind}{ends} {role}"
            if kind == "in":
                break
    return relation


def _dependency_path(tokens: ParsedTokens, verb: int, anchor: int) -> str:
    """Join the dependency labels from a span's head up to the lowest common ancestor and down to the verb.

    "apart" if they are in different trees, "far" with the number of labels upwards if the path is too long.
    """
    ancestors = {verb}
    index = verb
    while tokens.head[index] != index:
        index = tokens.head[index]
        ancestors.add(index)
    up: list[str] = []
    index = anchor
    while index not in ancestors:
        up.append(tokens.dep[index])
        if tokens.head[index] == index:
            return "apart"
        index = tokens.head[index]
    common = index
    down: list[str] = []
    index = verb
    while index != common:
        down.append(tokens.dep[index])
        index = tokens.head[index]
    path = [*up, "|", *reversed(down)]
    return ">".join(path) if len(path) <= _MAX_PATH_LABELS + 1 else f"far{len(up)}"


# The file arguments.npz


def pack_weights(names: Sequence[str], weights: FloatArray, provenance: str) -> bytes:
    """Pack a model as `arguments.npz`; the same input gives the same bytes.

    Args:
        names: n names of features.
        weights: (n, CLASSES).
        provenance: what the model was trained on.
    """
    buffer = io.BytesIO()
    lines = np.frombuffer("\n".join(names).encode("utf-8"), dtype=np.uint8)
    source = np.frombuffer(provenance.encode("utf-8"), dtype=np.uint8)
    np.savez_compressed(buffer, names=lines, weights=weights.astype(np.float16), provenance=source)
    return buffer.getvalue()


def read_provenance(data: bytes) -> str:
    """Read from an `arguments.npz` what its weights were trained on.

    Raises:
        BundleFormatError: the bytes are no such file.
    """
    return _read_arrays(data)["provenance"].tobytes().decode("utf-8")


def _read_arrays(data: bytes) -> dict[str, NDArray[Any]]:
    try:
        arrays = read_arrays(data, _LIMITS)
        missing = sorted(set(_LIMITS) - set(arrays))
    except UNREADABLE as error:
        raise BundleFormatError(f"arguments.npz does not hold the weights of arguments: {error}") from error
    if missing:
        raise BundleFormatError(f"arguments.npz does not hold the weights of arguments: it lacks {missing}")
    if arrays["names"].dtype != np.uint8 or arrays["weights"].dtype != np.float16:
        raise BundleFormatError("arguments.npz must hold names as bytes and weights as float16")
    return arrays


# Candidate spans: phrases of the dependency parse, whole and cut short


def candidate_spans(tokens: ParsedTokens) -> list[tuple[int, int, int]]:
    """List every span that may be an argument of some action, each once, as (first, last, anchor)."""
    children: list[list[int]] = [[] for _ in tokens.text]
    for index, head in enumerate(tokens.head):
        if head != index:
            children[head].append(index)
    anchors: dict[Span, int] = {}
    for anchor, pos in enumerate(tokens.pos):
        if pos not in _ANCHOR_POS or tokens.dep[anchor] in _NON_ANCHOR_DEPS or not has_word(tokens.text[anchor]):
            continue
        for raw_span in _spans_at(tokens, children, anchor):
            span = tokens.trim(raw_span)
            if span is not None:
                anchors.setdefault(span, anchor)
    _join_neighbours(tokens, anchors)
    return [(first, last, anchor) for (first, last), anchor in anchors.items()]


def _spans_at(tokens: ParsedTokens, children: list[list[int]], anchor: int) -> list[Span]:
    """List the spans around one anchor: its subtree, its phrase, and the phrase with some of its modifiers."""
    first, last = tokens.first[anchor], tokens.last[anchor]
    if tokens.dep[anchor] == "mark":  # a clause: from the word that opens it to the end of its verb's subtree
        return [(anchor, tokens.last[tokens.head[anchor]])]
    spans = [(first, last), (anchor, anchor)]
    core = _core_end(tokens, children, anchor)
    separators = [child for child in children[anchor] if child < anchor and tokens.dep[child] in ("cc", "punct")]
    left = max([first, *(separator + 1 for separator in separators)])
    if tokens.pos[anchor] in ("VERB", "AUX"):
        coordinated = [child for child in children[anchor] if child > anchor and tokens.dep[child] in ("cc", "conj")]
        end = coordinated[0] - 1 if coordinated else last
        return [*spans, (anchor, last), (anchor, core), (first, end), (anchor, end)]
    spans += [(left, core), (left, anchor), (anchor, core)]
    # cut before and after each modifier that follows the noun or preposition
    for child in children[anchor]:
        if child > anchor and tokens.dep[child] not in ("punct", "cc"):
            spans.append((left, tokens.first[child] - 1))
            spans.append((left, tokens.last[child]))
    return spans


def _core_end(tokens: ParsedTokens, children: list[list[int]], anchor: int) -> int:
    """Find the last token of a phrase without the modifiers that follow its noun."""
    objects = [
        child
        for child in children[anchor]
        if child > anchor and tokens.dep[child] in ("pobj", "pcomp", "dobj", "prep", "amod")
    ]
    if tokens.pos[anchor] in ("ADP", "SCONJ", "VERB") and objects:
        return _core_end(tokens, children, objects[0])
    return anchor


def _join_neighbours(tokens: ParsedTokens, anchors: dict[Span, int]) -> None:
    """Add the spans that a wrong attachment tore apart.

    In "makes a step | to the left" the parse may attach the modifier to the verb instead of the noun; in
    "walks up | a slope" it may attach the preposition to the verb.
    """
    modifier_ends: dict[int, int] = {}
    prepositional: list[tuple[int, int, int]] = []
    for first, last in anchors:
        is_preposition = tokens.pos[first] == "ADP" and last > first
        if is_preposition or (tokens.pos[first] == "ADV" and last == first):
            modifier_ends[first] = min(last, modifier_ends.get(first, last))
        anchor = anchors[first, last]
        if tokens.pos[first] in ("DET", "NUM", "NOUN", "PRON") and tokens.pos[anchor] == "NOUN" and first:
            verb_travels = tokens.lemma[tokens.head[first - 1]] in lexicon.TRAVEL_ON
            if verb_travels and last == anchor and tokens.pos[first - 1] == "ADP":
                prepositional.append((first - 1, last, first - 1))
    for (first, last), anchor in list(anchors.items()):
        if tokens.pos[anchor] in ("NOUN", "PROPN") and last == anchor and last + 1 in modifier_ends:
            anchors.setdefault((first, modifier_ends[last + 1]), anchor)
    for first, last, anchor in prepositional:
        anchors.setdefault((first, last), anchor)
