"""The argument classifier: its file, its scores, the best set of spans, and whole graphs for any text."""

from __future__ import annotations

import io
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.bundle.reader import text_files_folder
from kinegraph.errors import BundleFormatError, InvalidInputError
from kinegraph.graph import ARGUMENT_ROLES
from kinegraph.limits import MAX_NODES
from kinegraph.text.argument_classifier import (
    CLASSES,
    ArgumentCandidates,
    ArgumentClassifier,
    pack_weights,
    read_provenance,
    weighted_interval_scheduling,
)

FILE = text_files_folder() / "parser.bin"


def weights_for(**roles: str) -> bytes:
    """Weights under which each feature votes for one role."""
    table = np.zeros((len(roles), CLASSES), dtype=np.float32)
    for row, role in enumerate(roles.values()):
        table[row, ARGUMENT_ROLES.index(role) + 1] = 8.0
    return pack_weights(list(roles), table, "made by hand")


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 9), st.integers(0, 4), st.integers(-20, 20)).map(lambda x: (x[0], x[0] + x[1], x[2])),
        max_size=9,
    )
)
def test_scheduling_finds_the_best_set_of_all_sets_of_spans(rows: list[tuple[int, int, int]]) -> None:
    spans, gains = [row[:2] for row in rows], [float(row[2]) for row in rows]
    chosen = weighted_interval_scheduling(spans, gains)
    most = 0.0
    for size in range(len(rows) + 1):
        for indices in combinations(range(len(rows)), size):
            apart = all(spans[a][1] < spans[b][0] or spans[b][1] < spans[a][0] for a, b in combinations(indices, 2))
            most = max(most, sum(gains[index] for index in indices)) if apart else most
    assert sum(gains[index] for index in chosen) == most
    assert all(spans[a][1] < spans[b][0] for a, b in pairwise(chosen))


def test_scores_are_sums_and_unknown_features_are_ignored() -> None:
    classifier = ArgumentClassifier(weights_for(who="ARG0", where="ARGM-LOC"))
    scores = classifier.scores([["who", "never seen"], [], ["who", "where"]])
    assert scores[0, ARGUMENT_ROLES.index("ARG0") + 1] == 8.0
    assert not scores[1].any()
    assert scores[2].sum() == 16.0


def test_overlapping_spans_are_not_both_chosen() -> None:
    classifier = ArgumentClassifier(weights_for(who="ARG0", where="ARGM-LOC"))
    spans = [(0, 1, 1), (1, 3, 2), (5, 6, 5)]
    choice = classifier.choose(ArgumentCandidates(spans, [["who"], ["where", "where"], ["where"]]))
    assert choice.chosen == [("ARGM-LOC", (1, 3)), ("ARGM-LOC", (5, 6))]
    assert [span for _, span in choice.ranked] == [(1, 3), (0, 1), (5, 6)]


def test_equal_weights_give_equal_files_that_name_their_provenance() -> None:
    data = weights_for(who="ARG0")
    assert data == weights_for(who="ARG0")
    assert read_provenance(data) == "made by hand"


def npz(**changes: np.ndarray) -> bytes:
    arrays = {
        "names": np.frombuffer(b"a\nb", dtype=np.uint8),
        "weights": np.zeros((2, CLASSES), dtype=np.float16),
        "provenance": np.zeros(0, dtype=np.uint8),
    }
    buffer = io.BytesIO()
    np.savez(buffer, **{**arrays, **changes})
    return buffer.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"nonsense",
        npz()[:200],
        npz(weights=np.zeros((3, CLASSES), dtype=np.float16)),
        npz(weights=np.zeros((2, 3), dtype=np.float16)),
        npz(weights=np.full((2, CLASSES), np.nan, dtype=np.float16)),
        npz(weights=np.zeros((2, CLASSES), dtype=np.float64)),
        npz(names=np.array(["a", "b"])),
        npz(names=np.array([{}], dtype=object)),
    ],
)
def test_bytes_without_weights_are_refused(data: bytes) -> None:
    with pytest.raises(BundleFormatError):
        ArgumentClassifier(data)
    assert ArgumentClassifier(npz()).scores([["a"]]).shape == (1, CLASSES)


@pytest.fixture(scope="module")
def noisy_parser() -> object:
    """A parser with random weights: whatever it chooses, graphs must be valid."""
    pytest.importorskip("spacy")
    from kinegraph.text.parser import GraphParser

    names = [
        "bias",
        *(f"d:{dep}" for dep in ("nsubj", "dobj", "prep", "advmod", "pobj", "conj", "ROOT", "dep", "punct")),
    ]
    table = np.random.Generator(np.random.PCG64(0)).normal(0, 3, (len(names), CLASSES)).astype(np.float32)
    return GraphParser(FILE.read_bytes(), pack_weights(names, table, ""))


WORDS = st.sampled_from(
    [
        "a",
        "human",
        "walks",
        "and",
        "waves",
        ",",
        "then",
        "90",
        "°",
        "left",
        "走",
        "e\u0301",
        "\u200f😀",
        "who",
        "not",
        "\t",
    ]
)


@settings(max_examples=200, deadline=None)
@given(st.one_of(st.text(max_size=40), st.lists(WORDS, min_size=1, max_size=30).map(" ".join)))
def test_any_text_gives_a_valid_graph_or_a_typed_error(noisy_parser: object, text: str) -> None:
    try:
        graph = noisy_parser.parse(text)  # type: ignore[attr-defined]
    except InvalidInputError:
        return
    assert graph.caption == text
    assert graph.actions
    assert graph.node_count <= MAX_NODES
    assert graph == noisy_parser.parse(text)  # type: ignore[attr-defined]
    for action in graph.actions:
        for part in action.arguments:
            assert text[part.start : part.end] == part.text.strip() != ""
