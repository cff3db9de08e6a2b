"""Training the argument classifier on gold graphs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("spacy")

from kinegraph.bundle.reader import text_files_folder
from kinegraph.errors import InvalidInputError
from kinegraph.text.argument_classifier import read_provenance
from kinegraph.text.parser import GraphParser
from kinegraph_training.train_parser import gold_examples, read_gold, rule_examples, train

GOLD = Path(__file__).parents[2] / "benchmarks" / "parser" / "hard_sentences_dev.jsonl"


@pytest.fixture(scope="module")
def pipeline() -> bytes:
    return (text_files_folder() / "parser.bin").read_bytes()


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
    examples = gold_examples(GraphParser(pipeline), [graph])
    rows = list(zip(examples.features, examples.labels, examples.sample_weights, strict=True))
    lexicalised = [(names, label) for names, label, weight in rows if weight == 1]
    assert {label for names, label in lexicalised if "*t:a person" in names} == {1}
    assert {label for names, label in lexicalised if "*t:slowly" in names} == {11}  # OTHERS, punctuation aside
    assert {label for names, label in lexicalised if "*t:person" in names} <= {0}
    unlexicalised = [names for names, _, weight in rows if weight < 1]
    assert len(unlexicalised) == len(lexicalised)
    assert not any(name.startswith("*") for names in unlexicalised for name in names)


def test_the_rules_label_captions_without_annotation(pipeline: bytes) -> None:
    examples = rule_examples(GraphParser(pipeline), ["a person walks to the left"])
    labels = {tuple(name for name in names if name.startswith("*t:")): label
              for names, label in zip(examples.features, examples.labels, strict=True)}  # fmt: skip
    assert labels[("*t:to the left",)] == 9  # ARGM-DIR


def test_training_captions_are_parsed_as_in_the_gold(pipeline: bytes) -> None:
    graphs = read_gold(GOLD)
    data = train(GraphParser(pipeline), graphs, ["a person walks forward"], "own sentences")
    assert data == train(GraphParser(pipeline), graphs, ["a person walks forward"], "own sentences")
    assert read_provenance(data) == "own sentences"
    parser = GraphParser(pipeline, data)
    hits = wanted = 0
    for graph in graphs:
        parts = {(a["start"], p["start"], p["end"]): {p["role"], *p.get("also", ())}
                 for a in graph["actions"] for p in a["arguments"] if not p.get("optional")}  # fmt: skip
        parsed = parser.parse(graph["caption"])
        roles_by_span = {(a.start, p.start, p.end): p.role for a in parsed.actions for p in a.arguments}
        hits += sum(roles_by_span.get(key) in roles for key, roles in parts.items())
        wanted += len(parts)
    assert hits / wanted > 0.95


@pytest.mark.parametrize("content", ["no json", "[1]", json.dumps({"text": "a person walks"})])
def test_files_that_hold_no_graphs_are_refused(tmp_path: Path, content: str) -> None:
    file = tmp_path / "gold.jsonl"
    file.write_text(content)
    with pytest.raises(InvalidInputError, match="gold"):
        read_gold(file)
