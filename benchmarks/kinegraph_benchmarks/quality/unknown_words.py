"""Measure whether a user is told about words that a bundle never saw, and is not told in vain.

    python -m kinegraph_benchmarks.quality.unknown_words --held-out --out unknown_words.json

The sentences are those of `benchmarks/data`, whose README says where they come from. Every second line is the half
"dev", which was looked at while the search was developed; of the half "held out" only totals are stored. A sentence is
"told" if anything of it is told, and "all named" if every phrase is that its line lists. Of known sentences and of
paraphrases nothing should be told. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline, Unknown
from kinegraph.graph import SemanticGraph
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report

DATA: Final = Path(__file__).parents[2] / "data"
UNKNOWN: Final = ("unknown_sentences.jsonl", "reworded_sentences.jsonl")
KNOWN: Final = "known_sentences.jsonl"
HALVES: Final = ("dev", "held out")
REPEATS: Final = 5


@dataclass(frozen=True)
class Sentence:
    """A line of the data."""

    text: str
    unknown: tuple[str, ...]
    """Phrases of the text that must be named; none if nothing may be told."""
    kind: str
    half: str
    """One of `HALVES`."""


def read_sentences(path: Path) -> list[Sentence]:
    """Read a file of sentences; its lines belong to the halves by turns."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]
    return [
        Sentence(row["text"], tuple(row.get("unknown", ())), _kind(row), HALVES[number % 2])
        for number, row in enumerate(rows)
    ]


def _kind(row: dict[str, Any]) -> str:
    return f"known, {row['source']}" if "source" in row else str(row["kind"])


def all_named(sentence: Sentence, spans: Iterable[Unknown]) -> bool:
    """Tell whether every phrase that a sentence lists shares a character with something that is told."""
    spans = list(spans)
    return all(
        any(span.start < start + len(phrase) and start < span.end for span in spans)
        for phrase in sentence.unknown
        for start in [sentence.text.index(phrase)]
    )


def count_told(
    sentences: Sequence[Sentence], find: Callable[[str], Sequence[Unknown]]
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Count by half and kind what is told.

    Returns:
        Rows of half, kind, number of sentences, told and all named; and the sentences of the half "dev" that came out
        wrong, with what was told of them.
    """
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    wrong = []
    for sentence in sentences:
        key = (sentence.half, sentence.kind)
        row = rows.setdefault(key, {"half": key[0], "kind": key[1], "sentences": 0, "told": 0, "all_named": 0})
        spans = find(sentence.text)
        is_named = bool(sentence.unknown) and all_named(sentence, spans)
        row["sentences"] += 1
        row["told"] += bool(spans)
        row["all_named"] += is_named
        if sentence.half == HALVES[0] and (not is_named if sentence.unknown else bool(spans)):
            told = [span.text for span in spans]
            wrong.append({"text": sentence.text, "kind": sentence.kind, "unknown": sentence.unknown, "told": told})
    return list(rows.values()), wrong


def time_search(find: Callable[[SemanticGraph], object], graphs: Sequence[SemanticGraph]) -> dict[str, float]:
    """Time the search in parsed sentences: median, 95th percentile and longest, milliseconds, the best of `REPEATS`."""
    times = []
    for graph in graphs:
        best = np.inf
        for _ in range(REPEATS):
            start = time.perf_counter()
            find(graph)
            best = min(best, 1000.0 * (time.perf_counter() - start))
        times.append(best)
    quantiles = {"median": np.median(times), "p95": np.percentile(times, 95), "longest": np.max(times)}
    return {name: round(float(value), 3) for name, value in quantiles.items()}


def measure(pipe: MotionPipeline, halves: Sequence[str]) -> dict[str, Any]:
    """Measure all sentences of some halves, and the time of the search."""
    if pipe.vocabulary is None:
        raise SystemExit(
            f"{pipe.manifest.name} {pipe.manifest.version} has no vocabulary.npz: there is nothing to measure"
        )
    sentences = [sentence for name in (*UNKNOWN, KNOWN) for sentence in read_sentences(DATA / name)]
    chosen = [sentence for sentence in sentences if sentence.half in halves]
    rows, wrong = count_told(chosen, pipe.find_unknown)
    dev = [(sentence.kind, pipe.parse(sentence.text)) for sentence in chosen if sentence.half == HALVES[0]]
    is_known = {name: [graph for kind, graph in dev if kind.startswith("known") is known]
                for name, known in (("known sentence", True), ("unknown or reworded sentence", False))}  # fmt: skip
    milliseconds = {name: time_search(pipe.find_unknown, graphs) for name, graphs in is_known.items()}
    encoded = [graph for _, graph in dev]
    milliseconds["text encoder, for comparison"] = time_search(lambda graph: pipe.encoder.encode_text([graph]), encoded)
    return {
        "bundle": f"{pipe.manifest.name} {pipe.manifest.version}",
        "counts": rows,
        "wrong": wrong,
        "milliseconds": milliseconds,
    }


def summarise(rows: Sequence[dict[str, Any]], half: str) -> dict[str, tuple[int, int, int]]:
    """Sum sentences, told and all named of one half by what they should show."""
    groups = {
        "unknown": lambda kind: not kind.startswith("known") and kind not in ("paraphrase", "other order"),
        "other order": lambda kind: kind == "other order",
        "paraphrase": lambda kind: kind == "paraphrase",
        "known": lambda kind: kind.startswith("known"),
    }
    return {
        name: tuple(  # type: ignore[misc]
            sum(row[key] for row in rows if row["half"] == half and belongs(row["kind"]))
            for key in ("sentences", "told", "all_named")
        )
        for name, belongs in groups.items()
    }


def markdown_table(result: dict[str, Any]) -> str:
    """Format a result: a line for each half and kind, totals, times, and what was wrong in the half "dev"."""
    lines = ["| half | kind | sentences | told | all named |", "|---|---|---|---|---|"]
    for half in HALVES:
        own = [row for row in result["counts"] if row["half"] == half]
        for row in own:
            lines.append(_line(half, row["kind"], row["sentences"], row["told"], row["all_named"]))
        for name, (count, told, named) in summarise(own, half).items():
            lines += [_line(half, f"**all: {name}**", count, told, named)] if count else []
    lines += ["", "| ms, one core, the best of 5 | median | p95 | longest |", "|---|---|---|---|"]
    for name, times in result["milliseconds"].items():
        lines.append(f"| {name} | {times['median']:.2f} | {times['p95']:.2f} | {times['longest']:.2f} |")
    lines += [
        "",
        f"{result['bundle']}. Nothing should be told of known sentences and paraphrases. Wrong in the half dev:",
    ]
    for wrong in result["wrong"]:
        told = ", ".join(wrong["told"]) or "nothing"
        lines.append(f"- {wrong['text']!r} ({wrong['kind']}): told {told}")
    return "\n".join(lines) + "\n"


def _line(half: str, kind: str, count: int, told: int, named: int) -> str:
    is_known = kind.startswith("known") or "paraphrase" in kind or kind == "**all: known**"
    cells = [f"{told} ({told / count:.3f})", "" if is_known else f"{named} ({named / count:.3f})"]
    return f"| {half} | {kind} | {count} | {' | '.join(cells)} |"


def main() -> int:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    parser.add_argument(
        "--held-out", action="store_true", help="also the held-out half: for a last figure, not to tune"
    )
    add_arguments(parser, "bundle", "out")
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle, threads=1)
    result = measure(pipe, HALVES if options.held_out else HALVES[:1])
    write_report(options.out, result, markdown_table(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
