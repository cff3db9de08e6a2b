"""Captions to semantic graphs: spaCy's dependency parse, then rules (`kinegraph.text.rules`)."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any, Final

from kinegraph.errors import BundleError, BundleFormatError, InvalidInputError, MissingExtraError
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.limits import MAX_NODES, MAX_TEXT
from kinegraph.text import lexicon
from kinegraph.text.rules import CONTENT, Frame, Span, frame, is_action, trimmed
from kinegraph.text.tokens import check_unicode

PIPES: Final[tuple[str, ...]] = ("tok2vec", "tagger", "parser", "attribute_ruler", "lemmatizer")

_LISTENER: Final = {"@architectures": "spacy.Tok2VecListener.v1", "width": 96, "upstream": "tok2vec"}

COMPONENTS: Final[dict[str, dict[str, Any]]] = {
    "tok2vec": {
        "model": {
            "@architectures": "spacy.Tok2Vec.v2",
            "embed": {
                "@architectures": "spacy.MultiHashEmbed.v2",
                "width": 96,
                "attrs": ["NORM", "PREFIX", "SUFFIX", "SHAPE", "SPACY", "IS_SPACE"],
                "rows": [5000, 1000, 2500, 2500, 50, 50],
                "include_static_vectors": False,
            },
            "encode": {
                "@architectures": "spacy.MaxoutWindowEncoder.v2",
                "width": 96,
                "depth": 4,
                "window_size": 1,
                "maxout_pieces": 3,
            },
        }
    },
    "tagger": {"model": {"@architectures": "spacy.Tagger.v2", "nO": None, "normalize": False, "tok2vec": _LISTENER}},
    "parser": {
        "model": {
            "@architectures": "spacy.TransitionBasedParser.v2",
            "state_type": "parser",
            "extra_state_tokens": False,
            "hidden_width": 64,
            "maxout_pieces": 2,
            "use_upper": True,
            "nO": None,
            "tok2vec": _LISTENER,
        }
    },
    "attribute_ruler": {},
    "lemmatizer": {"mode": "rule"},
}
"""The pipeline is built from this table and only filled from the bundle's bytes: nothing in those names code."""


def load_pipeline(data: bytes) -> Any:
    """A spaCy pipeline of `COMPONENTS` with the weights of `nlp.to_bytes()`.

    Raises:
        MissingExtraError: spaCy is not installed.
        BundleFormatError: the bytes do not fit the pipeline.
    """
    try:
        from spacy.lang.en import English
        from spacy.tokenizer import Tokenizer
    except ImportError as error:
        raise MissingExtraError(
            'parsing a sentence needs spaCy: pip install "kinegraph[text]"; or pass a graph instead of a sentence'
        ) from error

    # The tokenizer's rules come with the bytes; making English's own first takes a tenth of a second.
    pipeline = English(create_tokenizer=lambda made: Tokenizer(made.vocab))
    for name in PIPES:
        pipeline.add_pipe(name, config=COMPONENTS[name])
    try:
        return pipeline.from_bytes(data, exclude=["meta", "config", "config.cfg", "meta.json"])
    except Exception as error:
        raise BundleFormatError(f"parser.bin does not hold the parser's weights: {error}") from error


def import_in_background() -> None:
    """Begin to import spaCy, which takes half a second, while something else is read."""

    def load() -> None:
        with suppress(ImportError):  # said by `load_pipeline`, to whoever asked for a sentence
            import spacy.lang.en  # noqa: F401

    threading.Thread(target=load, daemon=True).start()


class GraphParser:
    """Sentence to graph; deterministic, safe to share between threads.

    Raises:
        MissingExtraError: spaCy is not installed.
        BundleFormatError: the bytes are no pipeline.
    """

    def __init__(self, pipeline_bytes: bytes) -> None:
        self._pipeline = load_pipeline(pipeline_bytes)

    def parse(self, caption: str) -> SemanticGraph:
        """The graph of a caption, offsets in its characters; never empty for a caption with words in it.

        Raises:
            InvalidInputError: no text, blank, without a letter or digit, or longer than `limits.MAX_TEXT`.
        """
        check_caption(caption)
        doc = self._pipeline(clean(caption))
        frames = [frame(token) for token in doc if is_action(token)] or [fallback_frame(doc)]
        cover(doc, frames)
        return assembled(caption, doc, frames)


class LazyParser:
    """Makes the parser when the first sentence comes: whoever brings graphs never pays for spaCy."""

    def __init__(self, data: bytes | None) -> None:
        self._data = data
        self._lock = threading.Lock()
        self._parser: GraphParser | None = None

    def __call__(self) -> GraphParser:
        with self._lock:
            if self._parser is None:
                if self._data is None:
                    raise BundleError("this bundle carries no parser; pass a SemanticGraph instead of a sentence")
                self._parser = GraphParser(self._data)
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


def fallback_frame(doc: Any) -> Frame:
    """Captions without a verb: a noun that names a motion, else the head of the first content word, else a word."""
    worded = [token for token in doc if any(char.isalnum() for char in token.text)]
    events = [token for token in worded if token.lemma_.lower() in lexicon.EVENT_NOUNS]
    content = [token for token in worded if token.pos_ in CONTENT and not token.is_stop]
    return frame((events or [token.sent.root for token in content if token.sent.root in worded] or worded)[0])


def cover(doc: Any, frames: list[Frame]) -> None:
    """Give words with content that no node holds to the action nearest above them (or before them)."""
    held = {found.head.i for found in frames}
    for found in frames:
        for _, (first, last) in found.arguments:
            held.update(range(first, last + 1))
    loose = [token.i for token in doc if token.i not in held and token.pos_ in CONTENT and _counts(token)]
    for span in _runs(loose):
        kept = trimmed(doc, span)
        if kept is not None:
            _nearest(doc[kept[0]], frames).add("ARGM-MNR" if doc[kept[0]].pos_ in ("ADJ", "ADV") else "OTHERS", kept)


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


def assembled(caption: str, doc: Any, frames: list[Frame]) -> SemanticGraph:
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
        start, end = found.head.idx, found.head.idx + len(found.head)
        actions.append(Action(caption[start:end], start, end, order, arguments=tuple(arguments)))
    return SemanticGraph(caption, tuple(actions))
