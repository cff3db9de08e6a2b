"""Train the linear model that ranks and types the arguments of actions.

    python -m kinegraph_training.train_parser --gold GOLD benchmarks/parser/hard_sentences_dev.jsonl \
        --captions DATA/bandai/captions.jsonl --parser assets/parser.bin --provenance "..." --out assets/arguments.npz

Gold graphs are JSON lines, `{"caption", "actions": [{"start", "end", "arguments": [{"role", "start", "end"}]}]}` with
offsets in characters. Of each different caption one graph counts. The model is multinomial logistic regression with an
L2 penalty, fitted by L-BFGS: convex, so that the same captions give the same weights.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from kinegraph.errors import InvalidInputError
from kinegraph.graph import ARGUMENT_ROLES, OTHERS
from kinegraph.text.argument_classifier import CLASSES, packed
from kinegraph.text.parser import GraphParser, frame_candidates, predicate_frames
from kinegraph_training.synthetic.caption_grammar import MANNERS, PHRASES, sequence_caption, splice_caption

PENALTY = 1.0
ITERATIONS = 80
UNKNOWN_SHARE = 0.3
"""Every example counts this much once more without features of content words: the next caption has other words."""
RULE_SHARE = 0.25
"""What an example counts whose label comes from the rules."""
RULE_CAPTIONS = 600
"""Recorded captions that the rules label; made ones come on top."""
RARE = 2
"""Features seen less often are left out."""


@dataclass(frozen=True)
class Examples:
    """Spans with the names of their features, their class (0: no argument) and how much they count."""

    features: list[list[str]]
    labels: list[int]
    shares: list[float]

    def __add__(self, other: Examples) -> Examples:
        return Examples(self.features + other.features, self.labels + other.labels, self.shares + other.shares)


def read_gold(path: Path) -> list[dict[str, Any]]:
    """One graph for each different caption of a file.

    Raises:
        InvalidInputError: the file cannot be read, or a line is no graph.
    """
    try:
        rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
        return list({row["caption"]: row for row in rows}.values())
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InvalidInputError(f"{path} holds no gold graphs: {error}") from error


def words_of(caption: str, start: int, end: int) -> frozenset[int]:
    """Places of the letters and digits of a span: punctuation at its ends does not count."""
    return frozenset(place for place in range(start, end) if caption[place].isalnum())


def examples(parser: GraphParser, graphs: Iterable[dict[str, Any]]) -> Examples:
    """Every candidate span of every action that gold and rules share; gold actions without arguments say nothing."""
    made = Examples([], [], [])
    for graph in graphs:
        caption = graph["caption"]
        analysis = parser.analyse(caption)
        frames = predicate_frames(analysis)
        gold = {words_of(caption, a["start"], a["end"]): a["arguments"] for a in graph["actions"] if a["arguments"]}
        characters = [(token.idx, token.idx + len(token)) for token in analysis.written]
        for found, options in zip(frames, frame_candidates(analysis, frames), strict=True):
            arguments = gold.get(words_of(caption, *characters[found.head.i]))
            if arguments is None:
                continue
            wanted = {words_of(caption, a["start"], a["end"]): _class(a["role"]) for a in arguments}
            spans = [words_of(caption, characters[first][0], characters[last][1]) for first, last, _ in options.spans]
            labels = [wanted.get(span, 0) for span in spans]
            _append(made, options.features, labels, 1.0)
            _append(made, [[name for name in row if name[0] != "*"] for row in options.features], labels, UNKNOWN_SHARE)
    return made


def rule_examples(parser: GraphParser, captions: Iterable[str]) -> Examples:
    """Captions that nobody annotated, as the rules have them: they keep the model to the rules where gold is silent."""
    made = Examples([], [], [])
    for caption in captions:
        analysis = parser.analyse(caption)
        frames = predicate_frames(analysis)
        for found, options in zip(frames, frame_candidates(analysis, frames), strict=True):
            wanted = {span: _class(role) for role, span in found.arguments}
            labels = [wanted.get((first, last), 0) for first, last, _ in options.spans]
            _append(made, options.features, labels, RULE_SHARE)
    return made


def _append(made: Examples, features: list[list[str]], labels: list[int], share: float) -> None:
    made.features.extend(features)
    made.labels.extend(labels)
    made.shares.extend([share] * len(labels))


def _class(role: str) -> int:
    return ARGUMENT_ROLES.index(role if role in ARGUMENT_ROLES else OTHERS) + 1


def fit(found: Examples, penalty: float = PENALTY) -> tuple[list[str], np.ndarray]:
    """Names of features and their weights (n, CLASSES), float32."""
    counts = Counter(name for names in found.features for name in set(names))
    names = sorted(name for name, count in counts.items() if count >= RARE)
    index = {name: place for place, name in enumerate(names)}
    rows = [[index[name] for name in row if name in index] for row in found.features]
    flat = torch.tensor([place for row in rows for place in row])
    offsets = torch.tensor(np.cumsum([0] + [len(row) for row in rows])[:-1])
    labels, shares = torch.tensor(found.labels), torch.tensor(found.shares)
    weights = torch.zeros((len(names), CLASSES), requires_grad=True)
    optimiser = torch.optim.LBFGS([weights], max_iter=ITERATIONS, history_size=20, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimiser.zero_grad()
        scores = torch.nn.functional.embedding_bag(flat, weights, offsets, mode="sum")
        value = (
            shares * torch.nn.functional.cross_entropy(scores, labels, reduction="none")
        ).sum() + penalty / 2 * weights.square().sum()
        value.backward()
        return value

    optimiser.step(loss)
    return names, weights.detach().numpy()


def train(
    parser: GraphParser, graphs: Sequence[dict[str, Any]], captions: Sequence[str], provenance: str = ""
) -> bytes:
    """The content of `arguments.npz`.

    Args:
        parser: one without weights.
        graphs: gold, see `read_gold`.
        captions: others, which the rules label.
        provenance: where they come from and under which licences.
    """
    return packed(*fit(examples(parser, graphs) + rule_examples(parser, captions)), provenance)


def sampled_captions(path: Path, count: int) -> list[str]:
    """Some training captions of a prepared folder's captions.jsonl, and made ones of several actions.

    Raises:
        InvalidInputError: the file cannot be read.
    """
    rng = np.random.Generator(np.random.PCG64(0))
    try:
        rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        recorded = sorted({caption for row in rows if row["split"] == "train" for caption in row["captions"]})
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InvalidInputError(f"{path} holds no captions: {error}") from error
    chosen = [recorded[place] for place in rng.permutation(len(recorded))[:count]]
    for _ in range(count // 24):  # eight captions each: a third as many again
        first, second = (sorted(PHRASES)[place] for place in rng.choice(len(PHRASES), 2, replace=False))
        style = sorted(MANNERS)[int(rng.integers(len(MANNERS)))]
        chosen += [*sequence_caption(first, second, style, rng), *splice_caption(first, second, style, rng)]
    return chosen


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    options = argparse.ArgumentParser(prog="kinegraph_training.train_parser", description=__doc__.split("\n")[0])
    options.add_argument(
        "--gold", type=Path, nargs="+", required=True, help="JSON lines of gold graphs, or their folder"
    )
    options.add_argument(
        "--captions", type=Path, required=True, help="captions.jsonl of the motion: the rules label some"
    )
    options.add_argument("--parser", type=Path, required=True, help="the spaCy pipeline, parser.bin of the assets")
    options.add_argument("--provenance", required=True, help="where gold and captions come from, and their licences")
    options.add_argument("--out", type=Path, required=True, help="where arguments.npz goes")
    found = options.parse_args(argv)
    torch.set_num_threads(1)
    files = [file for path in found.gold for file in (sorted(path.glob("*.jsonl")) if path.is_dir() else [path])]
    graphs = [graph for path in files for graph in read_gold(path)]
    captions = sampled_captions(found.captions, RULE_CAPTIONS)
    data = train(GraphParser(found.parser.read_bytes()), graphs, captions, found.provenance)
    found.out.write_bytes(data)
    print(f"{len(data) / 1e3:.0f} kB from {len(graphs)} gold captions and {len(captions)} others in {found.out}")


if __name__ == "__main__":
    main()
