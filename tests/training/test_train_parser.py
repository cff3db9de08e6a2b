"""Training the linear model of arguments on gold graphs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("spacy")

from kinegraph.bundle.reader import DEFAULT_BUNDLE
from kinegraph.errors import InvalidInputError
from kinegraph.text.argument_classifier import provenance_of
from kinegraph.text.parser import GraphParser
from kinegraph_training.train_parser import examples, read_gold, rule_examples, train

GOLD = Path(__file__).parents[2] / "benchmarks" / "parser" / "hard_sentences_dev.jsonl"
pytestmark = pytest.mark.skipif(not (DEFAULT_BUNDLE / "parser.bin").is_file(), reason="no default bundle")


@pytest.fixture(scope="module")
def pipeline() -> bytes:
    return (DEFAULT_BUNDLE / "parser.bin").read_bytes()


def test_labels_are_the_roles_of_the_gold(pipeline: bytes) -> None:
    graph = {
        "caption": "a person walks slowly.",
        "actions": [
            {
                "start": 9,
                "end": 14,
                "arguments": [{"role": "ARG0", "start": 0, "end": 8}, {"role": "ARGM-XYZ", "start": 15, "end": 22}],
            }
        ],
    }
    found = examples(GraphParser(pipeline), [graph])
    whole = [
        (row, label) for row, label, share in zip(found.features, found.labels, found.shares, strict=True) if share == 1
    ]
    assert {label for row, label in whole if "*t:a person" in row} == {1}
    assert {label for row, label in whole if "*t:slowly" in row} == {11}  # OTHERS, punctuation aside
    assert {label for row, label in whole if "*t:person" in row} <= {0}
    bare = [row for row, share in zip(found.features, found.shares, strict=True) if share < 1]
    assert len(bare) == len(whole)
    assert not any(name.startswith("*") for row in bare for name in row)


def test_the_rules_label_what_nobody_annotated(pipeline: bytes) -> None:
    found = rule_examples(GraphParser(pipeline), ["a person walks to the left"])
    labels = {tuple(name for name in row if name.startswith("*t:")): label
              for row, label in zip(found.features, found.labels, strict=True)}  # fmt: skip
    assert labels[("*t:to the left",)] == 9  # ARGM-DIR


def test_what_was_trained_on_is_parsed_as_the_gold_has_it(pipeline: bytes) -> None:
    graphs = read_gold(GOLD)
    data = train(GraphParser(pipeline), graphs, ["a person walks forward"], "own sentences")
    assert data == train(GraphParser(pipeline), graphs, ["a person walks forward"], "own sentences")
    assert provenance_of(data) == "own sentences"
    parser = GraphParser(pipeline, data)
    hits = wanted = 0
    for graph in graphs:
        parts = {(a["start"], p["start"], p["end"]): {p["role"], *p.get("also", ())}
                 for a in graph["actions"] for p in a["arguments"] if not p.get("optional")}  # fmt: skip
        found = {(a.start, p.start, p.end): p.role for a in parser.parse(graph["caption"]).actions for p in a.arguments}
        hits += sum(found.get(key) in roles for key, roles in parts.items())
        wanted += len(parts)
    assert hits / wanted > 0.95


@pytest.mark.parametrize("content", ["no json", "[1]", json.dumps({"text": "a person walks"})])
def test_files_that_hold_no_graphs_are_refused(tmp_path: Path, content: str) -> None:
    file = tmp_path / "gold.jsonl"
    file.write_text(content)
    with pytest.raises(InvalidInputError, match="gold"):
        read_gold(file)
