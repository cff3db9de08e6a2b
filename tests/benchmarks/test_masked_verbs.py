"""Masking verbs changes the words of a graph and nothing else."""

from __future__ import annotations

import numpy as np

from kinegraph.conditioning import graph_structure
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph_benchmarks.quality.masked_verbs import PREDICATES, VerbMaskingModel, mask_verbs, predicate_rates
from kinegraph_training.data.clips import MotionClip
from support.motions import posed, t_pose, turn

CAPTION = "a person walks to the left, then bows slowly"


def node(text: str) -> dict[str, object]:
    start = CAPTION.index(text)
    return {"text": text, "start": start, "end": start + len(text)}


GRAPH = SemanticGraph(
    CAPTION,
    (
        Action(**node("walks"), order=0, arguments=(
            Argument("ARG0", **node("a person")), Argument("ARGM-DIR", **node("to the left"), weight=2.0))),
        Action(**node("bows"), order=1, weight=0.5, arguments=(Argument("ARGM-MNR", **node("slowly")),)),
    ),
)  # fmt: skip


def test_verbs_are_masked_and_all_else_stays() -> None:
    found = mask_verbs(GRAPH)
    assert found.caption == "a person [MASK] to the left, then [MASK] slowly"
    assert [action.text for action in found.actions] == ["[MASK]", "[MASK]"]
    texts = [[part.text for part in action.arguments] for action in found.actions]
    assert texts == [["a person", "to the left"], ["slowly"]]
    for own, other in zip(graph_structure(found), graph_structure(GRAPH), strict=True):
        np.testing.assert_array_equal(own, other)


def test_a_verb_inside_an_argument_is_masked_there_too() -> None:
    caption = "walks while waving hands"
    whole = Argument("ARGM-ADV", "while waving hands", 6, 24)
    waving = Action("waving", 12, 18, order=1, arguments=(Argument("ARG1", "hands", 19, 24),))
    found = mask_verbs(SemanticGraph(caption, (Action("walks", 0, 5, order=0, arguments=(whole,)), waving)))
    assert found.caption == "[MASK] while [MASK] hands"
    assert found.actions[0].arguments[0].text == "while [MASK] hands"
    assert found.actions[1].arguments[0].text == "hands"


class Parser:
    def parse(self, caption: str) -> SemanticGraph:
        assert caption == CAPTION
        return GRAPH


class Listener:
    name, stamp, fps, seconds_limits = "model", "stamp", 20.0, (1.0, 9.0)

    def generate(self, caption: object, **options: object) -> object:
        return caption, options


def test_the_model_hears_the_masked_graph() -> None:
    masked = VerbMaskingModel(Listener(), Parser())  # type: ignore[arg-type]
    assert masked.stamp != Listener.stamp
    heard, options = masked.generate(CAPTION, seconds=2.0, seed=3)
    assert heard == mask_verbs(GRAPH) and options == {"seconds": 2.0, "seed": 3}


def test_rates_are_told_apart_by_what_they_are_about() -> None:
    pivot = np.stack([posed(np.zeros(3), {0: turn("y", angle)}) for angle in np.linspace(0, np.pi / 2, 30)])
    still = t_pose(30)
    clips = [MotionClip(name, still, ("x",), (name,), "") for name in (*["walk-turn-left"] * 2, "wave-left-hand")]
    assert predicate_rates(clips, [pivot, still, still]) == {"direction": 0.5, "body part": 0.0}
    assert {"walk-turn-right", "raise-up-both-hands", "wave-right-hand"} <= set(PREDICATES)
