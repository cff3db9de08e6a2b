"""What the command line takes from its arguments and files."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from kinegraph.errors import InvalidInputError, KinegraphError
from kinegraph.limits import MAX_TAKES

if TYPE_CHECKING:
    from kinegraph.concepts import Concept
    from kinegraph.graph import SemanticGraph
    from kinegraph.pipeline import MotionPipeline

MAX_GRAPH_BYTES: Final = 1 << 20
MAX_CAPTIONS_BYTES: Final = 1 << 26


def load(bundle: Path | None, threads: int | None, parses: bool) -> MotionPipeline:
    """The pipeline of a bundle; where a sentence will be parsed (`parses`), spaCy is imported meanwhile.

    Raises:
        BundleError, InvalidInputError: as `MotionPipeline.load`.
    """
    from kinegraph.pipeline import MotionPipeline
    from kinegraph.text.dependency import import_in_background

    if parses:
        import_in_background()
    return MotionPipeline.load(bundle, threads=threads)


def level_steps(text: str) -> int | tuple[int, ...]:
    """`15` or `15,15,20`; the argparse type of `--steps`."""
    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number nor three, like 15,15,20") from None
    return numbers[0] if len(numbers) == 1 else numbers


def level_numbers(text: str) -> float | tuple[float, ...]:
    """`2.5` or `2.5,2.5,3`; the argparse type of `--guidance`."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number nor three, like 2.5,2.5,3") from None
    return numbers[0] if len(numbers) == 1 else numbers


def part_seconds(text: str) -> float | list[float]:
    """`3` or `3,2,3`; the argparse type of `--seconds` of a sequence."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no length, and no list of them like 3,2,3") from None
    return numbers[0] if len(numbers) == 1 else numbers


def weighted(text: str) -> tuple[str, float | None]:
    """`a person walks:0.8` -> its sentence and weight; without a number at the end there is none."""
    sentence, colon, number = text.rpartition(":")
    try:
        return (sentence, float(number)) if colon else (text, None)
    except ValueError:
        return text, None


def concepts(wanted: Sequence[str], unwanted: Sequence[str]) -> list[Concept]:
    """Of `--and` and `--not`; a negation's weight is given without its sign.

    Raises:
        InvalidInputError: a sentence or weight that is none.
    """
    from kinegraph.concepts import NEGATION_WEIGHT, Concept

    found = [Concept(text, 1.0 if weight is None else weight) for text, weight in map(weighted, wanted)]
    for text, weight in map(weighted, unwanted):
        found.append(Concept(text, NEGATION_WEIGHT if weight is None else -abs(weight)))
    return found


def input_graph(text: str | None, graph: str | None) -> str | SemanticGraph:
    """The sentence, or the graph read from a file or from stdin (`-`).

    Raises:
        InvalidInputError: neither or both are given, or the file cannot be read.
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


def edited(graph: SemanticGraph, edits: Sequence[tuple[str, str]]) -> SemanticGraph:
    """A graph after `--weight`, `--drop`, `--mask` and `--replace`, in the order typed.

    Raises:
        InvalidInputError: an edit that lacks its value.
        InvalidGraphError: a node that is not there, or a graph that cannot be.
    """
    from kinegraph.edits import masked, replaced, with_weight, without

    for name, text in edits:
        if name in ("--drop", "--mask"):
            graph = (without if name == "--drop" else masked)(graph, _node(text))
            continue
        node, equals, value = text.rpartition("=")
        if not equals:
            raise InvalidInputError(f"{name} {text!r}: write the part of the sentence, =, and its new value")
        if name == "--replace":
            graph = replaced(graph, _node(node), value)
            continue
        graph = with_weight(graph, _node(node), _number(value, f"{name} {text!r}"))
    return graph


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidInputError(f"{where}: {text!r} is no number") from None


def take_files(output: Path, takes: int) -> list[Path]:
    """The file, or for several takes `walk_1.bvh`, `walk_2.bvh` ...

    Raises:
        InvalidInputError: not 1 to `limits.MAX_TAKES`.
    """
    if not 1 <= takes <= MAX_TAKES:
        raise InvalidInputError(f"takes must be a whole number from 1 to {MAX_TAKES}, not {takes}")
    if takes == 1:
        return [output]
    digits = len(str(takes))
    return [output.with_name(f"{output.stem}_{take:0{digits}}{output.suffix}") for take in range(1, takes + 1)]


def named(name: str, text: str) -> tuple[str, str]:
    """An edit as it was typed: its flag and its value."""
    return name, text


def _node(text: str) -> str | int:
    """A node's text, or its number."""
    return int(text) if text.isascii() and text.strip().isdigit() else text


def check_only_jsonl(options: argparse.Namespace) -> None:
    """Many captions take no edit, and no picture.

    Raises:
        InvalidInputError: a sentence, a graph, an edit or a picture is asked for beside `--jsonl`.
    """
    for name, value in (("a sentence", options.text), ("--graph", options.graph), ("--svg", options.svg)):
        if value is not None:
            raise InvalidInputError(f"give either --jsonl FILE or {name}")
    if options.edits:
        raise InvalidInputError(f"{options.edits[0][0]} edits one sentence; leave it or --jsonl out")


def captions(jsonl: Path) -> list[tuple[str, str]]:
    """Captions of a file, each with its place for messages ("captions.jsonl, line 3").

    Raises:
        InvalidInputError: the file cannot be read, or a line holds no caption.
    """
    # Not splitlines(): that would also break captions at characters like U+2028.
    lines = _read_text(jsonl, MAX_CAPTIONS_BYTES).replace("\r\n", "\n").removesuffix("\n").split("\n")
    places = [f"{jsonl}, line {number}" for number in range(1, len(lines) + 1)]
    return [(place, _caption(line, place)) for place, line in zip(places, lines, strict=True)]


def _caption(line: str, place: str) -> str:
    if not line.strip():
        raise InvalidInputError(f"{place}: empty; a line is a caption or an object with the key caption")
    if not line.lstrip().startswith("{"):
        return line
    try:
        value = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"{place}: not valid JSON: {error}") from error
    caption = value.get("caption")
    if not isinstance(caption, str):
        raise InvalidInputError(f"{place}: the object needs a key caption with a text")
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
