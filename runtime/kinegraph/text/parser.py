"""Captions to semantic graphs.

The dependency parse (`analysis`) gives the actions and, by rules (`rules`), a first guess of their arguments; a linear
model ranks and types all phrases around an action (`spans`, `features`, `ranker`). Without its weights the rules stand
alone.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kinegraph.errors import BundleError, InvalidInputError
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.limits import MAX_NODES, MAX_TEXT
from kinegraph.text import lexicon
from kinegraph.text.argument_classifier import ArgumentClassifier, Candidates, candidates
from kinegraph.text.candidates import Span
from kinegraph.text.dependency import DependencyParse, DependencyParser
from kinegraph.text.rules import CONTENT, Frame, frame, is_action, is_certain, is_passive, trimmed
from kinegraph.text.tokenizer import check_unicode


class GraphParser:
    """Sentence to graph; deterministic, safe to share between threads.

    Args:
        pipeline_bytes: content of parser.bin.
        argument_weights: content of arguments.npz; None: rules alone.

    Raises:
        MissingExtraError: spaCy is not installed.
        BundleFormatError: the bytes are no pipeline, or no weights.
    """

    def __init__(self, pipeline_bytes: bytes, argument_weights: bytes | None = None) -> None:
        self._analyser = DependencyParser(pipeline_bytes)
        self._ranker = None if argument_weights is None else ArgumentClassifier(argument_weights)

    def parse(self, caption: str) -> SemanticGraph:
        """The graph of a caption, offsets in its characters; never empty for a caption with words in it.

        Raises:
            InvalidInputError: no text, blank, without a letter or digit, or longer than `limits.MAX_TEXT`.
        """
        check_caption(caption)
        analysis = self.analyse(caption)
        frames = predicate_frames(analysis)
        if self._ranker is not None:
            for found, options in zip(frames, frame_candidates(analysis, frames), strict=True):
                choice = self._ranker.choose(options)
                found.arguments = with_certain(choice.taken, found)
                found.others = choice.ranked
        attach_uncovered_words(analysis.parsed, frames)
        return build_graph(caption, analysis.written, frames)

    def analyse(self, caption: str) -> DependencyParse:
        """The words of a checked caption with their dependency parse."""
        return self._analyser(clean(caption))


def read_parser(folder: Path) -> GraphParser:
    """The parser of a folder of assets or of a bundle that is trusted: nothing is hashed.

    Raises:
        OSError: there is no parser.bin.
        MissingExtraError, BundleFormatError: see `GraphParser`.
    """
    weights = folder / "arguments.npz"
    return GraphParser((folder / "parser.bin").read_bytes(), weights.read_bytes() if weights.is_file() else None)


class LazyParser:
    """Makes the parser when the first sentence comes: whoever brings graphs never pays for spaCy."""

    def __init__(self, pipeline_bytes: bytes | None, argument_weights: bytes | None = None) -> None:
        self._data = None if pipeline_bytes is None else (pipeline_bytes, argument_weights)
        self._lock = threading.Lock()
        self._parser: GraphParser | None = None

    @staticmethod
    def of(files: Mapping[str, bytes]) -> LazyParser:
        """From the files of a bundle by name."""
        return LazyParser(files.get("parser.bin"), files.get("arguments.npz"))

    def __call__(self) -> GraphParser:
        with self._lock:
            if self._parser is None:
                if self._data is None:
                    raise BundleError("this bundle carries no parser; pass a SemanticGraph instead of a sentence")
                self._parser = GraphParser(*self._data)
                self._data = None
            return self._parser


def check_caption(caption: object) -> None:
    """Refuse what cannot be a caption, before anything is loaded or run."""
    if not isinstance(caption, str):
        raise InvalidInputError(f"a caption is a text, not {type(caption).__name__}")
    if len(caption) > MAX_TEXT:
        raise InvalidInputError(f"a caption may have {MAX_TEXT} characters, this one has {len(caption)}; shorten it")
    check_unicode(caption)
    if not any(char.isalnum() for char in caption):
        shown = "empty" if not caption.strip() else f"{caption[:40]!r}, without a letter or digit"
        raise InvalidInputError(f"the caption is {shown}; describe a motion, such as 'a person walks forward'")


def clean(caption: str) -> str:
    """Same length, so that offsets hold: white space and control characters become blanks."""
    return "".join(char if char.isprintable() else " " for char in caption)


def predicate_frames(analysis: DependencyParse) -> list[Frame]:
    """The actions of a caption, at least one, with their arguments by the rules."""
    doc = analysis.parsed
    return [frame(token) for token in doc if is_action(token)] or [fallback_frame(doc)]


def frame_candidates(analysis: DependencyParse, frames: list[Frame]) -> list[Candidates]:
    """What the linear model chooses from, for each action."""
    rules = [{span: role for role, span in found.arguments} for found in frames]
    voices = ["pass" if is_passive(found.head) else "act" for found in frames]
    return candidates(analysis.words, [found.head.i for found in frames], rules, voices)


def with_certain(chosen: list[tuple[str, Span]], found: Frame) -> list[tuple[str, Span]]:
    """What the rules are sure of, negation and agents, in place of any choice that overlaps it."""
    certain = [(role, span) for role, span in found.arguments if is_certain(found.head, span)]
    free = [
        (role, span) for role, span in chosen if all(span[1] < first or last < span[0] for _, (first, last) in certain)
    ]
    return sorted(certain + free, key=lambda item: item[1])


def fallback_frame(doc: Any) -> Frame:
    """Captions without a verb: a noun that names a motion, else the head of the first content word, else a word."""
    worded = [token for token in doc if any(char.isalnum() for char in token.text)]
    events = [token for token in worded if token.lemma_.lower() in lexicon.EVENT_NOUNS]
    content = [token for token in worded if token.pos_ in CONTENT and not token.is_stop]
    return frame((events or [token.sent.root for token in content if token.sent.root in worded] or worded)[0])


def attach_uncovered_words(doc: Any, frames: list[Frame]) -> None:
    """Give words with content that no node holds to the action nearest above them (or before them)."""
    held = {found.head.i for found in frames}
    for found in frames:
        for _, (first, last) in found.arguments:
            held.update(range(first, last + 1))
    loose = [token.i for token in doc if token.i not in held and token.pos_ in CONTENT and _counts(token)]
    for span in _runs(loose):
        kept = trimmed(doc, span)
        if kept is None or not held.isdisjoint(range(kept[0], kept[1] + 1)):
            continue  # nothing left, or held by now: a likelier span may reach over several runs
        nearest = _nearest(doc[kept[0]], frames)
        if nearest.others is None:
            nearest.add("ARGM-MNR" if doc[kept[0]].pos_ in ("ADJ", "ADV") else "OTHERS", kept)
        elif any(doc[place].pos_ not in ("ADP", "PART") for place in range(kept[0], kept[1] + 1)):
            role, (first, last) = _likeliest(kept, nearest, held)
            nearest.add(role, (first, last))
            held.update(range(first, last + 1))


def _likeliest(span: Span, found: Frame, held: set[int]) -> tuple[str, Span]:
    """The likeliest span around some words that no node holds; they themselves if there is none."""
    for role, (first, last) in found.others or ():
        if first <= span[0] and span[1] <= last and held.isdisjoint(range(first, last + 1)):
            return role, (first, last)
    return "OTHERS", span


def _counts(token: Any) -> bool:
    return any(char.isalnum() for char in token.text) and token.dep_ not in ("aux", "auxpass", "mark", "nsubj")


def _runs(numbers: list[int]) -> list[Span]:
    spans: list[Span] = []
    for number in numbers:
        if spans and number == spans[-1][1] + 1:
            spans[-1] = (spans[-1][0], number)
        else:
            spans.append((number, number))
    return spans


def _nearest(token: Any, frames: list[Frame]) -> Frame:
    by_head = {found.head.i: found for found in frames}
    for ancestor in token.ancestors:
        if ancestor.i in by_head:
            return by_head[ancestor.i]
    return min(frames, key=lambda found: abs(found.head.i - token.i))


def build_graph(caption: str, doc: Any, frames: list[Frame]) -> SemanticGraph:
    """Frames as a graph; past `limits.MAX_NODES` the last specifics go first, then the last actions."""
    frames = frames[: MAX_NODES - 1]
    room = MAX_NODES - 1 - len(frames)
    actions = []
    for order, found in enumerate(frames):
        arguments = []
        for role, (first, last) in sorted(found.arguments, key=lambda item: item[1])[:room]:
            start, end = doc[first].idx, doc[last].idx + len(doc[last])
            arguments.append(Argument(role, caption[start:end], start, end))
        room -= len(arguments)
        head = doc[found.head.i]
        start, end = head.idx, head.idx + len(head)
        actions.append(Action(caption[start:end], start, end, order, arguments=tuple(arguments)))
    return SemanticGraph(caption, tuple(actions))
