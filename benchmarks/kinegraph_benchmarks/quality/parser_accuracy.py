"""Measure how well sentences are parsed: against gold graphs by cross-validation, and on harder sentences of our own.

    python -m kinegraph_benchmarks.quality.parser_accuracy --gold graphs/kit_gold_dev.jsonl \
        --captions DATA/bandai/captions.jsonl \
        --out parser_accuracy.json

    ... --weights FILE [FILE ...]   files arguments.npz beside one another and beside the rules, and nothing is trained

The gold's own scorer (`score_graphs.py` beside it) does the counting. Captions that differ only in case or punctuation
are in one fold. The harder sentences and the typed ones (`benchmarks/parser`, sets 1 and 2) are parsed with weights
trained on all of the gold. Their halves "dev" were looked at while the parser was developed; they join the training set
for the halves "held out", which were not looked at. Typed sentences are also parsed with the weights of the bundle, and
their half "dev" is scored by kind. Marks of negated actions count apart: the scorer does not see them.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import random
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import torch

from kinegraph.bundle.reader import text_files_folder
from kinegraph.text.argument_classifier import pack_weights
from kinegraph.text.parser import GraphParser
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_training.train_parser import (
    RULE_CAPTIONS,
    Examples,
    fit,
    gold_examples,
    read_gold,
    rule_examples,
    sample_captions,
)

HARD = Path(__file__).parents[2] / "parser"


@dataclass(frozen=True)
class Half:
    """One half of a set of sentences with gold graphs by hand."""

    name: str
    path: Path
    is_dev: bool
    """True for the half that was looked at."""
    is_typed: bool
    """True for what people type, which names kinds and negated actions."""


HALVES = (
    Half("hard sentences, dev", HARD / "hard_sentences_dev.jsonl", True, False),
    Half("hard sentences, held out", HARD / "hard_sentences_held_out.jsonl", False, False),
    Half("typed sentences, dev", HARD / "hard_sentences_2_dev.jsonl", True, True),
    Half("typed sentences, held out", HARD / "hard_sentences_2_held_out.jsonl", False, True),
)
SHOWN = {
    "action": "actions",
    "argument_exact": "span",
    "labeled_exact": "typed span",
    "labeled_exact_matched_actions": "typed span, shared actions",
}


def read_scorer(path: Path) -> ModuleType:
    """Import the gold's scorer, a file, as a module."""
    spec = importlib.util.spec_from_file_location("score_graphs", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def assign_folds(captions: Iterable[str], count: int, seed: int, scorer: ModuleType) -> dict[str, int]:
    """Assign a fold to each caption; captions that differ only in case or punctuation share one."""
    groups = sorted({scorer.normal(caption) for caption in captions})
    random.Random(seed).shuffle(groups)
    fold = {group: number % count for number, group in enumerate(groups)}
    return {caption: fold[scorer.normal(caption)] for caption in captions}


def parse_captions(parser: GraphParser, captions: Iterable[str], scorer: ModuleType) -> dict[str, Any]:
    """Parse captions into graphs in the scorer's own form, by caption."""
    graphs = {}
    for caption in captions:
        name, graph, _ = scorer.read_graph(json.loads(parser.parse(caption).to_json()), caption)
        graphs[name] = graph
    return graphs


def cross_validate(
    parts: list[Examples], rest: Examples, folds: dict[str, int], pipeline: bytes, scorer: ModuleType
) -> dict[str, Any]:
    """Parse every caption with weights that saw none of its fold."""
    graphs: dict[str, Any] = {}
    for fold in range(len(parts)):
        training = sum((part for number, part in enumerate(parts) if number != fold), rest)
        parser = GraphParser(pipeline, pack_weights(*fit(training), ""))
        graphs |= parse_captions(parser, [caption for caption, number in folds.items() if number == fold], scorer)
    return graphs


def score_by_kind(path: Path, sentences: list[Any], graphs: dict[str, Any], scorer: ModuleType) -> dict[str, Any]:
    """Score the sentences of each kind that their file names."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    kinds: dict[str, set[str]] = {}
    for row in rows:
        kinds.setdefault(row["kind"], set()).add(row["caption"])
    return {
        kind: scorer.score([sentence for sentence in sentences if sentence[0] in captions], graphs)
        for kind, captions in kinds.items()
    }


def count_negations(parser: GraphParser, path: Path) -> dict[str, int]:
    """Count negated actions that are marked, missed, and marked in vain."""
    counts = {"marked": 0, "missed": 0, "in vain": 0}
    for line in path.read_text(encoding="utf-8").splitlines():
        row = json.loads(line)
        wanted = {(action["start"], action["end"]) for action in row["actions"] if action.get("negated")}
        found = {(action.start, action.end) for action in parser.parse(row["caption"]).actions if action.negated}
        counts["marked"] += len(wanted & found)
        counts["missed"] += len(wanted - found)
        counts["in vain"] += len(found - wanted)
    return counts


def time_parser(parser: GraphParser, captions: list[str]) -> float:
    """Measure the median CPU time of one caption, milliseconds, after a first run."""
    times = []
    for caption in captions:
        parser.parse(caption)
        start = time.thread_time()
        parser.parse(caption)
        times.append(time.thread_time() - start)
    return sorted(times)[len(times) // 2] * 1e3


def measure_accuracy(options: argparse.Namespace, scorer: ModuleType) -> dict[str, Any]:
    """Score the gold by cross-validation, then the other sentences with weights trained on all of it."""
    pipeline = options.parser.read_bytes()
    rules = GraphParser(pipeline)
    graphs, gold = read_gold(options.gold), list(scorer.read_file(options.gold))
    by_rules = rule_examples(rules, sample_captions(options.captions, RULE_CAPTIONS))
    folds = assign_folds([graph["caption"] for graph in graphs], options.folds, options.seed, scorer)
    parts = [
        gold_examples(rules, [graph for graph in graphs if folds[graph["caption"]] == fold])
        for fold in range(options.folds)
    ]
    learnt = cross_validate(parts, by_rules, folds, pipeline, scorer)
    rules_alone = parse_captions(rules, folds, scorer)
    scores = {
        "gold, all captions": scorer.score(gold, learnt),
        "gold, each caption once": scorer.score(gold, learnt, True),
        "gold, each once, rules alone": scorer.score(gold, rules_alone, True),
    }
    bundle = GraphParser(pipeline, options.parser.with_name("arguments.npz").read_bytes())
    result = {"folds": options.folds, "seed": options.seed, "scores": scores, "kinds": {}, "negations": {}}
    learn_from = sum(parts, by_rules)
    trained = [GraphParser(pipeline, pack_weights(*fit(learn_from), ""))]
    if options.held_out:
        dev = [gold_examples(rules, read_gold(half.path)) for half in HALVES if half.is_dev]
        trained.append(GraphParser(pipeline, pack_weights(*fit(sum(dev, learn_from)), "")))
    measure_sentences(result, trained, rules, bundle, scorer)
    return {**result, "milliseconds_per_caption": time_parser(bundle, sorted(folds))}


def measure_sentences(
    result: dict[str, Any], trained: list[GraphParser], rules: GraphParser, bundle: GraphParser, scorer: ModuleType
) -> None:
    """Score the harder and the typed sentences, and add the scores to a result.

    Args:
        result: with its "scores", "kinds" and "negations".
        trained: the parser with weights trained on the gold; a second one, trained on the halves "dev" as well, is for
            the halves that were not looked at, which are left out without it.
        rules: the parser without weights.
        bundle: the parser with the weights of the bundle.
        scorer: of the gold.
    """
    for half in (half for half in HALVES if half.is_dev or len(trained) > 1):
        sentences = list(scorer.read_file(half.path))
        captions = [caption for caption, _, _ in sentences]
        parsers = {half.name: trained[0 if half.is_dev else 1], f"{half.name}, rules alone": rules}
        if half.is_typed:
            parsers[f"{half.name}, default bundle"] = bundle
            result["negations"][half.name] = count_negations(bundle, half.path)
        for name, parser in parsers.items():
            graphs = parse_captions(parser, captions, scorer)
            result["scores"][name] = scorer.score(sentences, graphs)
            if half.is_typed and half.is_dev and parser is bundle:
                result["kinds"] = score_by_kind(half.path, sentences, graphs, scorer)


def compare_weights(options: argparse.Namespace, scorer: ModuleType) -> dict[str, Any]:
    """Score what files of weights make of the gold and of the halves that were not looked at, beside the rules."""
    pipeline = options.parser.read_bytes()
    parsers = {"rules alone": GraphParser(pipeline)}
    parsers |= {str(path): GraphParser(pipeline, path.read_bytes()) for path in options.weights}
    sets = {half.name: list(scorer.read_file(half.path)) for half in HALVES if not half.is_dev}
    sets["gold, each caption once"] = list(scorer.read_file(options.gold))
    scores = {}
    for name, sentences in sets.items():
        for weights, parser in parsers.items():
            graphs = parse_captions(parser, [caption for caption, _, _ in sentences], scorer)
            scores[f"{name}: {weights}"] = scorer.score(sentences, graphs, True)
    return {"scores": scores}


def markdown_table(result: dict[str, Any]) -> str:
    """Format a result as Markdown: F1 of actions and arguments, and whole graphs."""
    lines = [
        "| F1 | captions | " + " | ".join(SHOWN.values()) + " | whole graph |",
        "|---|" + "---|" * (len(SHOWN) + 2),
    ]
    lines += _rows(result["scores"])
    if "kinds" not in result:
        return "\n".join(lines) + "\n"
    lines += ["", "Typed sentences, dev, by kind, with the weights of the default bundle:", "", *lines[:2]]
    lines += _rows(result["kinds"])
    lines.append("")
    for name, counts in result["negations"].items():
        told = ", ".join(f"{count} {what}" for what, count in counts.items())
        lines.append(f"Negated actions, {name}: {told}.")
    lines += ["", f"{result['folds']} folds, seed {result['seed']}."]
    return "\n".join(lines) + "\n"


def _rows(scores: dict[str, Any]) -> list[str]:
    """Format one line for each report."""
    lines = []
    for name, report in scores.items():
        numbers = [report[key]["f1"] for key in SHOWN] + [report["graph_exact_labeled"]]
        lines.append(f"| {name} | {report['captions']} | " + " | ".join(f"{number:.3f}" for number in numbers) + " |")
    return lines


def main() -> int:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--gold", type=Path, required=True, help="gold graphs, JSON lines")
    parser.add_argument("--scorer", type=Path, help="score_graphs.py; the one beside the gold without it")
    parser.add_argument("--captions", type=Path, help="captions.jsonl of the motion; only --weights does without")
    parser.add_argument("--parser", type=Path, default=text_files_folder() / "parser.bin", help="the pipeline")
    parser.add_argument("--weights", type=Path, nargs="+", help="files arguments.npz to compare")
    parser.add_argument("--folds", type=int, default=5, help="of the cross-validation (5)")
    parser.add_argument("--seed", type=int, default=0, help="of the folds")
    parser.add_argument(
        "--held-out", action="store_true", help="also the held-out half: for a last figure, not to tune"
    )
    add_arguments(parser, "out")
    options = parser.parse_args()
    torch.set_num_threads(1)
    scorer = read_scorer(options.scorer or options.gold.with_name("score_graphs.py"))
    if options.captions is None and not options.weights:
        parser.error("--captions FILE is needed, or --weights FILE")
    result = compare_weights(options, scorer) if options.weights else measure_accuracy(options, scorer)
    write_report(options.out, result, markdown_table(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
