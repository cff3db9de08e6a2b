"""Input of the command line: arguments, files and stdin as bundles, graphs, concepts and captions."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from kinegraph.errors import InvalidInputError, KinegraphError
from kinegraph.limits import MAX_TAKES
from kinegraph.validation import short_repr

if TYPE_CHECKING:
    from kinegraph.concepts import Concept
    from kinegraph.graph import SemanticGraph
    from kinegraph.pipeline import MotionPipeline

MAX_GRAPH_BYTES: Final = 1 << 20
MAX_CAPTIONS_BYTES: Final = 1 << 26


def load_pipeline(bundle: str | None, threads: int | None, *, parses: bool) -> MotionPipeline:
    """Load a bundle.

    Args:
        bundle: its folder, or the name of an installed one; None takes the default bundle.
        threads: threads a model may use.
        parses: True if a sentence will be parsed: spaCy is then imported in the background meanwhile.

    Raises:
        BundleError, InvalidInputError: as `MotionPipeline.load`.
    """
    from kinegraph.pipeline import MotionPipeline
    from kinegraph.text.dependency import import_in_background

    if parses:
        import_in_background()
    return MotionPipeline.load(bundle, threads=threads)


def split_weight(text: str) -> tuple[str, float | None]:
    """Split `a person walks:0.8` into sentence and weight; the weight is None without a number at the end.

    Raises:
        InvalidInputError: the number is behind another sign, as in "a person walks=0.8", or what stands behind the
            colon is no number, as in "a person walks:2x".
    """
    if (wrong := re.search(r"\s*[=*@]\s*([-+]?\d+(?:\.\d+)?)\s*$", text)) is not None:
        raise InvalidInputError(f"{short_repr(text)}: write the weight as {text[: wrong.start()]}:{wrong[1]}")
    sentence, colon, number = text.rpartition(":")
    try:
        return (sentence, float(number)) if colon else (text, None)
    except ValueError:
        if not number.strip() or number[0].isspace():  # a colon of the sentence
            return text, None
        raise InvalidInputError(
            f"{short_repr(text)}: {short_repr(number)} is no weight; write one as in 'a person walks:0.8', or a space "
            "behind a colon of the sentence"
        ) from None


def parse_concepts(positive: Sequence[str], negated: Sequence[str]) -> list[Concept]:
    """Make the concepts of `--and` and `--not`; the weight of a negation is written without its sign.

    Raises:
        InvalidInputError: an invalid sentence or weight.
    """
    from kinegraph.concepts import NEGATION_WEIGHT, Concept

    concepts = [Concept(text, 1.0 if weight is None else weight) for text, weight in map(split_weight, positive)]
    for text, weight in map(split_weight, negated):
        concepts.append(Concept(text, NEGATION_WEIGHT if weight is None else -abs(weight)))
    return concepts


def read_text_or_graph(text: str | None, graph: str | None) -> str | SemanticGraph:
    """Return the sentence, or read the graph.

    Args:
        text: the sentence.
        graph: name of a JSON file, or `-` for stdin.

    Raises:
        InvalidInputError: neither or both are set, or the file cannot be read.
        InvalidGraphError: the file holds no graph.
    """
    if (text is None) == (graph is None):
        raise InvalidInputError("give either a sentence or --graph FILE")
    if graph is None:
        return text or ""
    from kinegraph.graph import SemanticGraph

    content = _read_stdin(MAX_GRAPH_BYTES) if graph == "-" else _read_text(Path(graph), MAX_GRAPH_BYTES)
    try:
        return SemanticGraph.from_json(content)
    except KinegraphError as error:
        raise type(error)(f"{'stdin' if graph == '-' else graph}: {error}") from error


def apply_edits(graph: SemanticGraph, edits: Sequence[tuple[str, str]]) -> SemanticGraph:
    """Apply `--weight`, `--drop`, `--mask` and `--replace` to a graph, in the order typed.

    Args:
        graph: the graph to edit.
        edits: pairs of flag and value.

    Raises:
        InvalidInputError: an edit lacks its value.
        InvalidGraphError: a node does not exist, or the edited graph is invalid.
    """
    from kinegraph.edits import masked, replaced, with_weight, without

    for flag, text in edits:
        if flag in ("--drop", "--mask"):
            graph = (without if flag == "--drop" else masked)(graph, _node(text))
            continue
        node, equals, value = text.rpartition("=")
        if not equals:
            raise InvalidInputError(f"{flag} {text!r}: write the part of the sentence, =, and its new value")
        if flag == "--replace":
            graph = replaced(graph, _node(node), value)
            continue
        graph = with_weight(graph, _node(node), _number(value, f"{flag} {text!r}"))
    return graph


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidInputError(f"{where}: {text!r} is no number") from None


def take_paths(output: Path, takes: int) -> list[Path]:
    """List the files of several takes: `walk_1.bvh`, `walk_2.bvh` ...; one take keeps the name of `output`.

    Raises:
        InvalidInputError: `takes` is not 1 to `limits.MAX_TAKES`.
    """
    if not 1 <= takes <= MAX_TAKES:
        raise InvalidInputError(f"takes must be a whole number from 1 to {MAX_TAKES}, not {takes}")
    if takes == 1:
        return [output]
    if not output.name:
        raise InvalidInputError(f"-o {str(output)!r} is a folder; name a file, such as walk.bvh")
    digits = len(str(takes))
    return [output.with_name(f"{output.stem}_{take:0{digits}}{output.suffix}") for take in range(1, takes + 1)]


def _node(text: str) -> str | int:
    """Read a node: its number, or its text."""
    return int(text) if text.isascii() and text.strip().isdigit() else text


def check_jsonl_alone(args: argparse.Namespace) -> None:
    """Refuse a sentence, a graph, edits and a picture beside `--jsonl`.

    Raises:
        InvalidInputError: one of them is set.
    """
    for name, value in (("a sentence", args.text), ("--graph", args.graph), ("--svg", args.svg)):
        if value is not None:
            raise InvalidInputError(f"give either --jsonl FILE or {name}")
    if args.edits:
        raise InvalidInputError(f"{args.edits[0][0]} edits one sentence; leave it or --jsonl out")


def read_captions(jsonl: Path) -> list[tuple[str, str]]:
    """Read the captions of a file, one per line.

    Returns:
        Pairs of location, for messages ("captions.jsonl, line 3"), and caption.

    Raises:
        InvalidInputError: the file cannot be read, or a line holds no caption.
    """
    # Not splitlines(): that would also break captions at characters like U+2028.
    lines = _read_text(jsonl, MAX_CAPTIONS_BYTES).replace("\r\n", "\n").removesuffix("\n").split("\n")
    locations = [f"{jsonl}, line {number}" for number in range(1, len(lines) + 1)]
    return [(location, _caption(line, location)) for location, line in zip(locations, lines, strict=True)]


def _caption(line: str, location: str) -> str:
    if not line.strip():
        raise InvalidInputError(f"{location}: empty; a line is a caption or an object with the key caption")
    if not line.lstrip().startswith("{"):
        return line
    try:
        value = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"{location}: not valid JSON: {error}") from error
    caption = value.get("caption")
    if not isinstance(caption, str):
        raise InvalidInputError(f"{location}: the object needs a key caption with a text")
    return caption


def _read_text(path: Path, most: int) -> str:
    try:
        if not path.is_file():
            raise InvalidInputError(f"no such file: {str(path)!r}")
        with path.open("rb") as file:
            return _decode(file.read(most + 1), str(path), most)
    except (OSError, ValueError) as error:
        if isinstance(error, KinegraphError):
            raise
        raise InvalidInputError(f"cannot read {str(path)!r}: {error}") from error


def _read_stdin(most: int) -> str:
    return _decode(sys.stdin.buffer.read(most + 1), "stdin", most)


def _decode(data: bytes, name: str, most: int) -> str:
    if len(data) > most:
        raise InvalidInputError(f"{name} is larger than {most} bytes")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{name} is not UTF-8 text: {error}") from error
