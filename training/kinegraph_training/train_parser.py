"""Train the argument classifier of the parser on gold graphs and on captions that the rules label.

    python -m kinegraph_training.train_parser --gold GOLD benchmarks/parser/hard_sentences_dev.jsonl \
        --captions DATA/bandai/captions.jsonl --parser assets/parser.bin --provenance "..." --out assets/arguments.npz

Gold graphs are JSON lines, `{"caption", "actions": [{"start", "end", "arguments": [{"role", "start", "end"}]}]}`, with
offsets in characters; of each different caption the last graph counts. The classifier is multinomial logistic
regression with an L2 penalty, fitted by L-BFGS. The loss is convex, so the same captions give the same weights.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from kinegraph.errors import InvalidInputError
from kinegraph.graph import ARGUMENT_ROLES, OTHERS
from kinegraph.text.argument_classifier import CLASSES, pack_weights
from kinegraph.text.parser import GraphParser, frame_candidates, predicate_frames
from kinegraph_training.synthetic.caption_grammar import (
    CAPTIONS,
    PHRASES,
    STYLE_PHRASES,
    sequence_caption,
    splice_caption,
)

PENALTY = 1.0
"""Coefficient of the L2 penalty."""
ITERATIONS = 80
UNLEXICALISED_WEIGHT = 0.3
"""Weight of the copy of each gold example without features of content words: new captions have other words."""
RULE_WEIGHT = 0.25
"""Weight of an example that the rules label."""
RULE_CAPTIONS = 600
"""Recorded captions that the rules label; synthetic ones are added."""
MIN_COUNT = 2
"""Features that occur less often are left out."""


@dataclass(frozen=True)
class Examples:
    """Weighted training examples, one for each candidate span of an action."""

    features: list[list[str]] = field(default_factory=list)
    """Names of the span's features."""
    labels: list[int] = field(default_factory=list)
    """Classes; 0 is no argument."""
    sample_weights: list[float] = field(default_factory=list)

    def add(self, features: list[list[str]], labels: list[int], weight: float) -> None:
        """Append the candidate spans of one action, all with the same weight."""
        self.features.extend(features)
        self.labels.extend(labels)
        self.sample_weights.extend([weight] * len(labels))

    def __add__(self, other: Examples) -> Examples:
        return Examples(
            self.features + other.features,
            self.labels + other.labels,
            self.sample_weights + other.sample_weights,
        )


def read_gold(path: Path) -> list[dict[str, Any]]:
    """Read one graph for each different caption of a file.

    Raises:
        InvalidInputError: the file cannot be read, or a line is no graph.
    """
    try:
        rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
        return list({row["caption"]: row for row in rows}.values())
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InvalidInputError(f"{path} holds no gold graphs: {error}") from error


def gold_examples(parser: GraphParser, graphs: Iterable[dict[str, Any]]) -> Examples:
    """Label the candidate spans of every action that gold and parser share.

    Gold actions without arguments are left out. Each example is added a second time without features of content
    words, with weight `UNLEXICALISED_WEIGHT`.
    """
    examples = Examples()
    for graph in graphs:
        caption = graph["caption"]
        parse = parser.parse_dependencies(caption)
        frames = predicate_frames(parse)
        gold = {
            _alphanumeric_offsets(caption, action["start"], action["end"]): action["arguments"]
            for action in graph["actions"]
            if action["arguments"]
        }
        offsets = parse.offsets
        for frame, candidates in zip(frames, frame_candidates(parse, frames), strict=True):
            arguments = gold.get(_alphanumeric_offsets(caption, *offsets[frame.head.i]))
            if arguments is None:
                continue
            classes = {_alphanumeric_offsets(caption, a["start"], a["end"]): _class_of(a["role"]) for a in arguments}
            labels = [
                classes.get(_alphanumeric_offsets(caption, offsets[first][0], offsets[last][1]), 0)
                for first, last, _ in candidates.spans
            ]
            unlexicalised = [[name for name in names if name[0] != "*"] for names in candidates.features]
            examples.add(candidates.features, labels, 1.0)
            examples.add(unlexicalised, labels, UNLEXICALISED_WEIGHT)
    return examples


def rule_examples(parser: GraphParser, captions: Iterable[str]) -> Examples:
    """Label the candidate spans of captions without annotation by the rules.

    They keep the classifier close to the rules where the gold graphs have no examples.
    """
    examples = Examples()
    for caption in captions:
        parse = parser.parse_dependencies(caption)
        frames = predicate_frames(parse)
        for frame, candidates in zip(frames, frame_candidates(parse, frames), strict=True):
            classes = {span: _class_of(role) for role, span in frame.arguments}
            labels = [classes.get((first, last), 0) for first, last, _ in candidates.spans]
            examples.add(candidates.features, labels, RULE_WEIGHT)
    return examples


def _alphanumeric_offsets(caption: str, start: int, end: int) -> frozenset[int]:
    """Offsets of a span's letters and digits, so that spans are equal whatever punctuation is at their ends."""
    return frozenset(index for index in range(start, end) if caption[index].isalnum())


def _class_of(role: str) -> int:
    """Class of a role; roles beyond the twelve edge types count as OTHERS."""
    return ARGUMENT_ROLES.index(role if role in ARGUMENT_ROLES else OTHERS) + 1


def fit(examples: Examples, penalty: float = PENALTY) -> tuple[list[str], np.ndarray]:
    """Fit multinomial logistic regression by L-BFGS.

    Minimises sum_i s_i * cross_entropy(W^T x_i, y_i) + penalty / 2 * |W|^2, where x_i is the binary vector of the
    features of example i, y_i its class and s_i its weight.

    Returns:
        Names of the n features, sorted, and their weights (n, CLASSES), float32.
    """
    counts = Counter(name for names in examples.features for name in set(names))
    names = sorted(name for name, count in counts.items() if count >= MIN_COUNT)
    index = {name: row for row, name in enumerate(names)}
    rows = [[index[name] for name in row if name in index] for row in examples.features]
    # embedding_bag sums the rows of W that an example's features select: W^T x for binary x
    flat = torch.tensor([feature for row in rows for feature in row])
    offsets = torch.tensor(np.cumsum([0] + [len(row) for row in rows])[:-1])
    labels, sample_weights = torch.tensor(examples.labels), torch.tensor(examples.sample_weights)
    weights = torch.zeros((len(names), CLASSES), requires_grad=True)
    optimiser = torch.optim.LBFGS([weights], max_iter=ITERATIONS, history_size=20, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimiser.zero_grad()
        scores = torch.nn.functional.embedding_bag(flat, weights, offsets, mode="sum")
        cross_entropy = torch.nn.functional.cross_entropy(scores, labels, reduction="none")
        value = (sample_weights * cross_entropy).sum() + penalty / 2 * weights.square().sum()
        value.backward()
        return value

    optimiser.step(loss)
    return names, weights.detach().numpy()


def train(
    parser: GraphParser, graphs: Sequence[dict[str, Any]], captions: Sequence[str], provenance: str = ""
) -> bytes:
    """Train the argument classifier and pack it as `arguments.npz`.

    Args:
        parser: one without weights of the classifier.
        graphs: gold graphs, see `read_gold`.
        captions: captions that the rules label.
        provenance: where graphs and captions come from, and their licences.
    """
    examples = gold_examples(parser, graphs) + rule_examples(parser, captions)
    return pack_weights(*fit(examples), provenance)


def sample_captions(path: Path, count: int) -> list[str]:
    """Sample training captions of a prepared folder's captions.jsonl, and generate a third as many of several actions.

    Raises:
        InvalidInputError: the file cannot be read.
    """
    rng = np.random.Generator(np.random.PCG64(0))
    try:
        rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        recorded = sorted({caption for row in rows if row["split"] == "train" for caption in row["captions"]})
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InvalidInputError(f"{path} holds no captions: {error}") from error
    captions = [recorded[index] for index in rng.permutation(len(recorded))[:count]]
    for _ in range(count // (6 * CAPTIONS)):  # twice as many captions each
        first, second = (sorted(PHRASES)[index] for index in rng.choice(len(PHRASES), 2, replace=False))
        style = sorted(STYLE_PHRASES)[int(rng.integers(len(STYLE_PHRASES)))]
        captions += [*sequence_caption(first, second, style, rng), *splice_caption((first, second), style, rng)]
    return captions


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_training.train_parser", description=__doc__.split("\n")[0])
    parser.add_argument(
        "--gold", type=Path, nargs="+", required=True, help="JSON lines of gold graphs, or their folder"
    )
    parser.add_argument(
        "--captions", type=Path, required=True, help="captions.jsonl of the motion: the rules label some"
    )
    parser.add_argument("--parser", type=Path, required=True, help="the spaCy pipeline, parser.bin of the assets")
    parser.add_argument("--provenance", required=True, help="where gold and captions come from, and their licences")
    parser.add_argument("--out", type=Path, required=True, help="where arguments.npz goes")
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    files = [file for path in options.gold for file in (sorted(path.glob("*.jsonl")) if path.is_dir() else [path])]
    graphs = [graph for path in files for graph in read_gold(path)]
    captions = sample_captions(options.captions, RULE_CAPTIONS)
    data = train(GraphParser(options.parser.read_bytes()), graphs, captions, options.provenance)
    options.out.write_bytes(data)
    print(f"{len(data) / 1e3:.0f} kB from {len(graphs)} gold captions and {len(captions)} others in {options.out}")


if __name__ == "__main__":
    main()
