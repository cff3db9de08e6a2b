"""Parse a caption into its semantic graph (GraphMotion, section 3.1).

The stages, in the order of `GraphParser.parse`:

1. `caption_tokens` chooses the words that are read; `clauses` finds the verbs that their place tells.
2. `dependency` parses these words, after `normalise` has corrected them.
3. `rules` finds the actions and a first guess of their arguments: the predicate frames.
4. `quantities` makes what says how long or how often an argument of its own.
5. `argument_classifier` lists the spans that may be arguments, scores them and selects the best set without overlap.
6. Content words that no node covers join the nearest action.
7. `negation` marks the actions that must not happen.
8. The frames become a graph with character offsets.

Without weights of the argument classifier, stage 5 is left out and the arguments of the rules stand.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kinegraph.errors import BundleError, InvalidInputError, KinegraphError, ModelError
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.limits import MAX_NODES, MAX_TEXT
from kinegraph.text import lexicon
from kinegraph.text.argument_classifier import ArgumentCandidates, ArgumentClassifier, argument_candidates
from kinegraph.text.dependency import DependencyParse, DependencyParser, ParsedTokens, Span, has_word
from kinegraph.text.negation import mark_negations, negated_events
from kinegraph.text.quantities import iterate_adverbial
from kinegraph.text.rules import (
    CONTENT_POS,
    PredicateFrame,
    build_frame,
    is_action,
    is_passive,
    sequence_words,
    subject_role,
    trim_in_doc,
)
from kinegraph.text.tokenizer import check_unicode


class GraphParser:
    """Caption to semantic graph; deterministic, safe to share between threads.

    Args:
        pipeline_bytes: content of parser.bin.
        argument_weights: content of arguments.npz; None: rules alone.

    Raises:
        MissingExtraError: spaCy is not installed.
        BundleFormatError: the bytes are no pipeline, or no weights.
    """

    def __init__(self, pipeline_bytes: bytes, argument_weights: bytes | None = None) -> None:
        self._dependency_parser = DependencyParser(pipeline_bytes)
        self._classifier = None if argument_weights is None else ArgumentClassifier(argument_weights)
        self._lock = threading.Lock()

    def parse(self, caption: str) -> SemanticGraph:
        """Parse a caption into a graph with at least one action, offsets in characters of the caption.

        One caption at a time: what spaCy remembers of new words is dropped with the caption, and its memory zones
        belong to one caller. Otherwise 10,000 sentences of new words would keep 20 MB.

        Raises:
            InvalidInputError: no text, blank, without a letter or digit, or longer than `limits.MAX_TEXT`.
            ModelError: spaCy failed.
        """
        check_caption(caption)
        with self._lock, self._dependency_parser.forgetting():
            try:
                return self._parse(caption)
            except KinegraphError:
                raise
            except Exception as error:
                raise ModelError(f"the parser failed at {caption[:40]!r}: {error}") from error

    def _parse(self, caption: str) -> SemanticGraph:
        parse = self.parse_dependencies(caption)
        frames = predicate_frames(parse)
        add_quantities(caption, parse, frames)
        if self._classifier is not None:
            for frame, candidates in zip(frames, frame_candidates(parse, frames), strict=True):
                if frame.head.i not in parse.states:
                    choice = self._classifier.choose(candidates)
                    frame.arguments = keep_certain_arguments(frame, choice.chosen)
                    frame.ranked = choice.ranked
        drop_arguments_of_others(parse, frames)
        share_subjects(parse, frames)
        attach_uncovered_words(parse.doc, frames)
        if may_negate(parse.tokens):
            mark_negations(parse.tokens, frames)
        return build_graph(caption, parse.offsets, frames)

    def parse_dependencies(self, caption: str) -> DependencyParse:
        """Parse the dependencies of a checked caption."""
        return self._dependency_parser(caption)


class LazyParser:
    """Builds the parser when the first sentence comes, so that callers who pass graphs never load spaCy."""

    def __init__(self, pipeline_bytes: bytes | None, argument_weights: bytes | None = None) -> None:
        self._data = None if pipeline_bytes is None else (pipeline_bytes, argument_weights)
        self._lock = threading.Lock()
        self._parser: GraphParser | None = None

    @staticmethod
    def from_files(files: Mapping[str, bytes]) -> LazyParser:
        """Take the parser's files, if there are any, from those of a bundle by name."""
        return LazyParser(files.get("parser.bin"), files.get("arguments.npz"))

    def __call__(self) -> GraphParser:
        with self._lock:
            if self._parser is None:
                if self._data is None:
                    raise BundleError("this bundle carries no parser; pass a SemanticGraph instead of a sentence")
                self._parser = GraphParser(*self._data)
                self._data = None
            return self._parser


def read_parser(folder: Path) -> GraphParser:
    """Read the parser of a folder of assets or of a trusted bundle; no hashes are checked.

    Raises:
        OSError: there is no parser.bin.
        MissingExtraError, BundleFormatError: see `GraphParser`.
    """
    weights = folder / "arguments.npz"
    return GraphParser((folder / "parser.bin").read_bytes(), weights.read_bytes() if weights.is_file() else None)


def check_caption(caption: object) -> None:
    """Refuse what cannot be a caption, before anything is loaded or run."""
    if not isinstance(caption, str):
        raise InvalidInputError(f"a caption is a text, not {type(caption).__name__}")
    if len(caption) > MAX_TEXT:
        raise InvalidInputError(f"a caption may have {MAX_TEXT} characters, this one has {len(caption)}; shorten it")
    check_unicode(caption)
    if not has_word(caption):
        problem = "empty" if not caption.strip() else f"{caption[:40]!r}, without a letter or digit"
        raise InvalidInputError(f"the caption is {problem}; describe a motion, such as 'a person walks forward'")


def predicate_frames(parse: DependencyParse) -> list[PredicateFrame]:
    """Find the actions of a caption, at least one, with their arguments by the rules."""
    verbs = parse.clause_verbs | parse.states
    heads = [token for token in parse.doc if token.i in verbs or (is_action(token) and not _is_held(parse, token))]
    is_negative = not _NEGATED_NOUNS.isdisjoint(parse.tokens.text)
    events = [token for token in negated_events(parse.doc) if token not in heads] if is_negative else []
    frames = [build_frame(token) for token in sorted(heads + events, key=lambda token: token.i)]
    for frame in frames:
        if frame.head.i in parse.states:
            frame.arguments = [(state_role(role, frame), span) for role, span in frame.arguments]
    return frames or [build_frame(token) for token in fallback_heads(parse.doc)]


def _is_held(parse: DependencyParse, token: Any) -> bool:
    """Tell whether a token is a part of the body in a phrase without a verb ("elbows | out"), taken for a verb."""
    return bool(parse.states) and parse.tokens.text[token.i] in lexicon.BODY_NOUNS


def add_quantities(caption: str, parse: DependencyParse, frames: list[PredicateFrame]) -> None:
    """Make what says how long or how often an argument of its own ("spins around | three times")."""
    for start, end in iterate_adverbial(caption):
        inside = [index for index, offsets in enumerate(parse.offsets) if start <= offsets[0] and offsets[1] <= end]
        if not inside:
            continue
        span = inside[0], inside[-1]
        before = [frame for frame in frames if frame.head.i < span[0]]
        frame = before[-1] if before else _nearest_frame(parse.doc[span[1]], frames)
        if frame.head.i in inside:
            continue
        frame.arguments = [(role, other) for role, other in frame.arguments if other[1] < span[0] or span[1] < other[0]]
        frame.add("ARGM-TMP", span, certain=True)


_NEGATED_NOUNS = frozenset(("no", "without"))
_NEGATIVE_WORDS = lexicon.NEGATORS | {"instead", "rather"}
_NEGATIVE_VERBS = lexicon.ENDING | lexicon.KEEPING


def may_negate(tokens: ParsedTokens) -> bool:
    """Tell whether a caption holds a word that may negate an action; most hold none."""
    return not (_NEGATIVE_WORDS.isdisjoint(tokens.text) and _NEGATIVE_VERBS.isdisjoint(tokens.lemma))


def state_role(role: str, frame: PredicateFrame) -> str:
    """Choose the role in a phrase without a verb: ARG1 is in a state or at ARG2 ("hands | on the hips")."""
    if role == "ARG0":
        return "ARG1"
    has_subject = any(other == "ARG0" for other, _ in frame.arguments)
    return "ARG2" if role == "ARG1" and has_subject else role


def fallback_heads(doc: Any) -> list[Any]:
    """Choose the actions of a caption without a verb.

    Coordinated nouns that name motions; else the root of a sentence with a content word; else the first word.
    """
    words = [token for token in doc if has_word(token.text)]
    events = [token for token in words if token.lemma_.lower() in lexicon.EVENT_NOUNS]
    if events:
        first = events[0]
        return [
            first,
            *(token for token in events[1:] if token.dep_ in ("conj", "ROOT", "appos") and first.i != token.i),
        ]
    content = [token for token in words if token.pos_ in CONTENT_POS and not token.is_stop]
    roots = [token.sent.root for token in content if token.sent.root in words]
    return (roots or words)[:1]


def frame_candidates(parse: DependencyParse, frames: list[PredicateFrame]) -> list[ArgumentCandidates]:
    """List the candidate spans of each action with their features, the rules' guess among them."""
    rule_roles = [{span: role for role, span in frame.arguments} for frame in frames]
    voices = ["pass" if is_passive(frame.head) else "act" for frame in frames]
    return argument_candidates(parse.tokens, [frame.head.i for frame in frames], rule_roles, voices)


def keep_certain_arguments(frame: PredicateFrame, chosen: list[tuple[str, Span]]) -> list[tuple[str, Span]]:
    """Let the certain arguments of the rules replace the classifier's choices that overlap them."""
    certain = [(role, span) for role, span in frame.arguments if span in frame.certain]
    free = [
        (role, span) for role, span in chosen if all(span[1] < first or last < span[0] for _, (first, last) in certain)
    ]
    return sorted(certain + free, key=lambda argument: argument[1])


def drop_arguments_of_others(parse: DependencyParse, frames: list[PredicateFrame]) -> None:
    """Take from each action the words that begin another clause, and "then" of a later action or beside its own."""
    owners = {(index, index): frame for frame in frames for index in sequence_words(frame.head)}
    heads = {frame.head.i for frame in frames}
    for frame in frames:
        has_own = any(owner is frame for owner in owners.values())
        frame.arguments = [
            (role, span)
            for role, span in frame.arguments
            if not _begins_clause(parse, span, heads - {frame.head.i})
            and (owners.get(span, frame) is frame or not (has_own or frame.head.i < span[0]))
        ]


def _begins_clause(parse: DependencyParse, span: Span, heads: set[int]) -> bool:
    """Tell whether a span begins with the verb of a clause of its own, perhaps with adverbs before it."""
    for index in range(span[0], span[1] + 1):
        if index in parse.clause_verbs:
            return index in heads
        if parse.tokens.pos[index] not in ("ADV", "PUNCT", "CCONJ"):
            return False
    return False


def share_subjects(parse: DependencyParse, frames: list[PredicateFrame]) -> None:
    """Give verbs in the third person without a subject that of the action before them, also of a step before."""
    subject: Span | None = None
    for frame in frames:
        own = next(
            (span for role, span in frame.arguments if role in ("ARG0", "ARG1") and span[1] < frame.head.i), None
        )
        if own is not None:
            subject = own
        elif subject is not None and frame.head.i in parse.clause_verbs and frame.head.tag_ == "VBZ":
            role = subject_role(frame.head, any(child.dep_ == "dobj" for child in frame.head.children))
            frame.arguments = [argument for argument in frame.arguments if argument[1] != subject]
            frame.add(role, subject)


def attach_uncovered_words(doc: Any, frames: list[PredicateFrame]) -> None:
    """Give content words that no node covers to the action nearest above them in the parse, else in the sentence."""
    covered = {frame.head.i for frame in frames}
    for frame in frames:
        for _, (first, last) in frame.arguments:
            covered.update(range(first, last + 1))
    uncovered = [token.i for token in doc if token.i not in covered and _is_attachable(token)]
    for run in _contiguous_spans(uncovered):
        span = trim_in_doc(doc, run)
        if span is None or not covered.isdisjoint(range(span[0], span[1] + 1)):
            continue  # nothing is left, or a span attached before reaches over it
        frame = _nearest_frame(doc[span[0]], frames)
        if frame.ranked is None:
            frame.add("ARGM-MNR" if doc[span[0]].pos_ in ("ADJ", "ADV") else "OTHERS", span)
        elif any(doc[index].pos_ not in ("ADP", "PART") for index in range(span[0], span[1] + 1)):
            role, (first, last) = _likeliest_around(span, frame.ranked, covered)
            frame.add(role, (first, last))
            covered.update(range(first, last + 1))


def _is_attachable(token: Any) -> bool:
    has_content = token.pos_ in CONTENT_POS and has_word(token.text)
    return has_content and token.dep_ not in ("aux", "auxpass", "mark", "nsubj")


def _contiguous_spans(indices: list[int]) -> list[Span]:
    """Group ascending token indices into spans without gaps."""
    spans: list[Span] = []
    for index in indices:
        if spans and index == spans[-1][1] + 1:
            spans[-1] = (spans[-1][0], index)
        else:
            spans.append((index, index))
    return spans


def _nearest_frame(token: Any, frames: list[PredicateFrame]) -> PredicateFrame:
    by_head = {frame.head.i: frame for frame in frames}
    for ancestor in token.ancestors:
        if ancestor.i in by_head:
            return by_head[ancestor.i]
    return min(frames, key=lambda frame: abs(frame.head.i - token.i))


def _likeliest_around(span: Span, ranked: list[tuple[str, Span]], covered: set[int]) -> tuple[str, Span]:
    """Take the likeliest candidate that contains a span and no covered word, else the span itself as OTHERS."""
    for role, (first, last) in ranked:
        if first <= span[0] and span[1] <= last and covered.isdisjoint(range(first, last + 1)):
            return role, (first, last)
    return "OTHERS", span


def build_graph(caption: str, offsets: Sequence[tuple[int, int]], frames: list[PredicateFrame]) -> SemanticGraph:
    """Convert frames to a graph with character offsets.

    Beyond `limits.MAX_NODES` nodes, the last arguments are dropped first, then the last actions.

    Args:
        caption: the caption.
        offsets: characters of each token of the frames.
        frames: the actions in the order of the caption.
    """
    frames = frames[: MAX_NODES - 1]
    room = MAX_NODES - 1 - len(frames)
    actions = []
    for order, frame in enumerate(frames):
        arguments = []
        for role, (first, last) in sorted(frame.arguments, key=lambda argument: argument[1])[:room]:
            start, end = offsets[first][0], offsets[last][1]
            arguments.append(Argument(role, caption[start:end], start, end))
        room -= len(arguments)
        start, end = offsets[frame.head.i]
        actions.append(Action(caption[start:end], start, end, order, arguments=tuple(arguments), negated=frame.negated))
    return SemanticGraph(caption, tuple(actions))
