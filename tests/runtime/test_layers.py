"""Concepts over spans of a timeline: which sentences they count for, and that those are composed with them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph import Concept, MotionPipeline
from kinegraph.errors import InvalidInputError
from kinegraph.layers import Layer, check_layers, notes_of
from kinegraph.part_memory import PartMemory
from kinegraph.timeline import generate_timeline

ENDS = [2.0, 4.0, 6.0]
WAVE = "a person waves the right hand"


def counts_for(begin: float, end: float) -> list[int]:
    (layer,) = check_layers([Layer(WAVE, begin, end)], ENDS)
    return [index for index, span in enumerate([(0, 2), (2, 4), (4, 6)]) if layer.touches(*span)]


@pytest.mark.parametrize(
    ("begin", "end", "sentences"),
    [
        (0, 2, [0]),
        (0, 6, [0, 1, 2]),
        (1.5, 2.05, [0]),
        (1.5, 2.2, [0, 1]),
        (1.98, 2.04, [1]),
        (5.9, 99, [2]),
        (2, 4, [1]),
    ],
)
def test_a_layer_counts_for_the_sentences_that_it_touches(begin: float, end: float, sentences: list[int]) -> None:
    assert counts_for(begin, end) == sentences


def test_a_span_that_covers_a_sentence_partly_is_told() -> None:
    layers = check_layers([Layer(WAVE, 0, 2), Layer(WAVE, 1, 3), Layer(WAVE, 4, 9)], ENDS)
    (note,) = notes_of(layers, ENDS)
    assert note.startswith(f'"{WAVE}" counts from 0 to 4 s') and "from 1 to 3 s" in note


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ([("a person waves", 0, 1)], "a list of Layer"),
        (Layer(WAVE, 0, 1), "a list of Layer"),
        ([Layer(WAVE, 7, 8)], r"layers\[0\] begins at 7 s, behind the end"),
        ([Layer(WAVE, 0, 1)] * 8, "8 layers touch sentence 1"),
        ([Layer(WAVE, 0, 1)] * 65, "at most 64 layers"),
    ],
)
def test_layers_that_do_not_fit_are_refused(layers: Any, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        check_layers(layers, ENDS)


@pytest.mark.parametrize(
    "values", [("", 0, 1), (WAVE, 1, 1), (WAVE, -1, 1), (WAVE, 0, np.nan), (WAVE, "0", 1), (WAVE, 0, 1, 0)]
)
def test_what_is_no_layer_is_refused(values: Any) -> None:
    with pytest.raises(InvalidInputError):
        Layer(*values)


def test_one_sentence_with_a_layer_is_its_composition(toy: MotionPipeline) -> None:
    options: dict[str, Any] = {"seconds": 2, "seed": 3, "steps": 2}
    layers = [Layer(WAVE, 0, 2, 0.8), Layer("a person turns left", 0, 2, -0.3)]
    clip = generate_timeline(toy, ["a person walks"], layers=layers, **options)
    concepts = ["a person walks", Concept(WAVE, 0.8), Concept("a person turns left", -0.3)]
    composed = toy.compose(concepts, **options)
    np.testing.assert_array_equal(clip.joints, composed.joints)
    assert clip.text == composed.text and not clip.misses


def test_only_sentences_under_a_layer_are_composed_and_others_stay(toy: MotionPipeline) -> None:
    assert toy.sampler.sessions.decoder_gradients
    texts, memory = ["a person walks", "a person bows", "a person walks"], PartMemory()
    options: dict[str, Any] = {"seconds": 1, "seed": 3, "steps": 2}
    plain = generate_timeline(toy, texts, **options, memory=memory)
    clip = generate_timeline(toy, texts, layers=[Layer(WAVE, 2, 3)], **options, memory=memory)
    assert memory.made == (2,)
    np.testing.assert_array_equal(clip.joints[:36], plain.joints[:36])
    assert np.abs(clip.joints[45:] - plain.joints[45:]).max() > 0.01
    generate_timeline(toy, texts, layers=[Layer(WAVE, 2, 3, 0.5)], **options, memory=memory)
    assert memory.made == (2,)  # another weight is another part
