"""EnergyMoGen, Eq. 11, against a loop over frames; and what of a token belongs to which interval."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.diffusion.temporal import (
    Span,
    claim_features,
    compose_over_time,
    count_claims,
    shared_spans,
    widen,
)

WIDTH = 6
WHOLE = np.ones(WIDTH, dtype=np.float32)


def drawn(rng: np.random.Generator, tokens: int) -> np.ndarray:
    return rng.standard_normal((tokens, WIDTH)).astype(np.float32)


def composed(length: int, spans: list[Span], masks: list[np.ndarray], seed: int = 0) -> tuple[np.ndarray, ...]:
    """M, the M_i and M_0 of random predictions."""
    rng = np.random.default_rng(seed)
    predictions, nothing = [drawn(rng, len(span)) for span in spans], drawn(rng, length)
    claims = claim_features(length, spans, masks)
    return compose_over_time(spans, claims, predictions, nothing), *predictions, nothing


@pytest.mark.parametrize(("first", "second", "shared"), [(7, 9, 3), (5, 5, 5), (4, 6, 1), (6, 4, 0)])
def test_two_texts_are_joined_by_equation_eleven(first: int, second: int, shared: int) -> None:
    length = first + second - shared
    spans = [Span(0, first), Span(first - shared, length)]
    found, one, two, nothing = composed(length, spans, [WHOLE, WHOLE])
    expected = []
    for frame in range(first - shared):  # M_1[: N_1 - N']
        expected.append(one[frame])
    for frame in range(shared):  # M_1[N_1 - N' :] + M_2[: N'] - M_3
        expected.append(one[first - shared + frame] + two[frame] - nothing[first - shared + frame])
    for frame in range(shared, second):  # M_2[N' :]
        expected.append(two[frame])
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_any_number_of_texts_in_a_row_and_at_once() -> None:
    spans = [Span(0, 6), Span(4, 10), Span(8, 12), Span(4, 6)]
    found, *predictions, nothing = composed(12, spans, [WHOLE] * 4, seed=3)
    for token in range(12):
        known = [
            part[token - span.start]
            for part, span in zip(predictions, spans, strict=True)
            if span.start <= token < span.stop
        ]
        np.testing.assert_allclose(found[token], sum(known) - (len(known) - 1) * nothing[token], atol=1e-5)


def test_one_text_is_its_own_prediction_bit_for_bit() -> None:
    found, alone, _ = composed(8, [Span(0, 8)], [WHOLE])
    np.testing.assert_array_equal(found, alone)


def test_parts_of_the_body_follow_their_own_text() -> None:
    legs, arm = np.float32([1, 1, 0, 0, 0, 0]), np.float32([0, 0, 0, 0, 1, 0])
    found, walk, wave, _ = composed(8, [Span(0, 8), Span(2, 5)], [legs, arm], seed=1)
    expected = walk.copy()  # what nobody asks for follows the text of most features
    expected[2:5, 4] = wave[:, 4]
    np.testing.assert_array_equal(found, expected)


def test_a_text_for_the_whole_body_gives_way_to_one_for_a_part() -> None:
    arm = np.float32([0, 0, 0, 0, 1, 0])
    found, walk, wave, turn, nothing = composed(8, [Span(0, 8), Span(2, 5), Span(6, 8)], [WHOLE, arm, WHOLE], seed=3)
    expected = walk.copy()
    expected[2:5, 4] = wave[:, 4]
    expected[6:] += turn - nothing[6:]  # two for the whole body are Eq. 11
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_what_two_texts_want_is_shared_and_nothing_else() -> None:
    legs, body = np.float32([1, 1, 0, 0, 0, 0]), np.float32([1, 1, 1, 1, 1, 0])
    spans = [Span(0, 4), Span(2, 6)]
    found, one, two, nothing = composed(6, spans, [legs, body], seed=2)
    np.testing.assert_allclose(found[2:4, :2], one[2:, :2] + two[:2, :2] - nothing[2:4, :2], atol=1e-6)
    np.testing.assert_array_equal(found[2:4, 2:], two[:2, 2:])
    np.testing.assert_array_equal(found[:2], one[:2])


def test_where_nothing_is_wanted_the_prediction_is_unconditional() -> None:
    found, _, _, nothing = composed(9, [Span(0, 3), Span(5, 9)], [WHOLE, WHOLE])
    np.testing.assert_array_equal(found[3:5], nothing[3:5])


def test_the_unconditional_prediction_is_made_where_it_is_needed() -> None:
    spans = [Span(0, 6), Span(4, 9), Span(11, 12)]
    count = count_claims(12, spans, claim_features(12, spans, [WHOLE] * 3))
    assert shared_spans(count) == [Span(4, 6), Span(9, 11)]
    assert shared_spans(np.ones((4, WIDTH), dtype=np.float32)) == []
    assert shared_spans(np.full((4, WIDTH), 2, dtype=np.float32)) == [Span(0, 4)]


@pytest.mark.parametrize(
    ("span", "expected"),
    [
        (Span(4, 6), Span(3, 7)), (Span(0, 2), Span(0, 4)), (Span(10, 12), Span(8, 12)), (Span(3, 9), Span(3, 9)),
        (Span(11, 12), Span(8, 12)), (Span(5, 6), Span(4, 8)),
    ],
)  # fmt: skip
def test_short_spans_are_widened_within_the_whole(span: Span, expected: Span) -> None:
    found = widen(span, 4, 12)
    assert found == expected and found.start <= span.start and span.stop <= found.stop
    assert widen(span, 40, 12) == Span(0, 12)
