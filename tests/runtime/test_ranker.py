"""The linear model of arguments: its file, its scores, the best set of spans, and any text through it."""

from __future__ import annotations

import io
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kinegraph
from kinegraph.errors import BundleFormatError, InvalidInputError
from kinegraph.graph import ARGUMENT_ROLES
from kinegraph.limits import MAX_NODES
from kinegraph.text.argument_classifier import (
    CLASSES,
    ArgumentClassifier,
    Candidates,
    packed,
    provenance_of,
    weighted_interval_scheduling,
)

FILE = Path(kinegraph.__file__).parent / "bundles" / "default" / "parser.bin"


def weights_for(**roles: str) -> bytes:
    """Each feature speaks for one role."""
    table = np.zeros((len(roles), CLASSES), dtype=np.float32)
    for row, role in enumerate(roles.values()):
        table[row, ARGUMENT_ROLES.index(role) + 1] = 8.0
    return packed(list(roles), table, "made by hand")


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 9), st.integers(0, 4), st.integers(-20, 20)).map(lambda x: (x[0], x[0] + x[1], x[2])),
        max_size=9,
    )
)
def test_the_best_set_of_spans_is_that_of_trying_all(rows: list[tuple[int, int, int]]) -> None:
    spans, gains = [row[:2] for row in rows], [float(row[2]) for row in rows]
    chosen = weighted_interval_scheduling(spans, gains)
    most = 0.0
    for size in range(len(rows) + 1):
        for places in combinations(range(len(rows)), size):
            apart = all(spans[a][1] < spans[b][0] or spans[b][1] < spans[a][0] for a, b in combinations(places, 2))
            most = max(most, sum(gains[place] for place in places)) if apart else most
    assert sum(gains[place] for place in chosen) == most
    assert all(spans[a][1] < spans[b][0] for a, b in pairwise(chosen))


def test_scores_are_sums_and_unknown_features_count_nothing() -> None:
    ranker = ArgumentClassifier(weights_for(who="ARG0", where="ARGM-LOC"))
    scores = ranker.scores([["who", "never seen"], [], ["who", "where"]])
    assert scores[0, ARGUMENT_ROLES.index("ARG0") + 1] == 8.0
    assert not scores[1].any()
    assert scores[2].sum() == 16.0


def test_spans_that_overlap_are_not_both_taken() -> None:
    ranker = ArgumentClassifier(weights_for(who="ARG0", where="ARGM-LOC"))
    found = Candidates([(0, 1, 1), (1, 3, 2), (5, 6, 5)], [["who"], ["where", "where"], ["where"]])
    choice = ranker.choose(found)
    assert choice.taken == [("ARGM-LOC", (1, 3)), ("ARGM-LOC", (5, 6))]
    assert [span for _, span in choice.ranked] == [(1, 3), (0, 1), (5, 6)]


def test_a_file_is_the_same_for_the_same_weights_and_names_its_source() -> None:
    data = weights_for(who="ARG0")
    assert data == weights_for(who="ARG0")
    assert provenance_of(data) == "made by hand"


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
def test_bytes_that_are_no_weights_are_refused(data: bytes) -> None:
    with pytest.raises(BundleFormatError):
        ArgumentClassifier(data)
    assert ArgumentClassifier(npz()).scores([["a"]]).shape == (1, CLASSES)


@pytest.fixture(scope="module")
def wild() -> object:
    """A parser whose weights are noise: whatever it chooses, graphs must be whole."""
    pytest.importorskip("spacy")
    if not FILE.is_file():
        pytest.skip("no default bundle")
    from kinegraph.text.parser import GraphParser

    names = [
        "bias",
        *(f"d:{dep}" for dep in ("nsubj", "dobj", "prep", "advmod", "pobj", "conj", "ROOT", "dep", "punct")),
    ]
    table = np.random.Generator(np.random.PCG64(0)).normal(0, 3, (len(names), CLASSES)).astype(np.float32)
    return GraphParser(FILE.read_bytes(), packed(names, table, ""))


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
def test_any_text_gives_a_whole_graph_or_a_typed_error(wild: object, text: str) -> None:
    try:
        graph = wild.parse(text)  # type: ignore[attr-defined]
    except InvalidInputError:
        return
    assert graph.caption == text
    assert graph.actions
    assert graph.node_count <= MAX_NODES
    assert graph == wild.parse(text)  # type: ignore[attr-defined]
    for action in graph.actions:
        for part in action.arguments:
            assert text[part.start : part.end] == part.text.strip() != ""
