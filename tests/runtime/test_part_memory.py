"""Parts of sequences are kept under all that they depend on, and few of them: what did not change is not made again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kinegraph import InvalidInputError, MotionPipeline, clip_editing
from kinegraph.clip import Clip
from kinegraph.part_memory import PartMemory

TEXTS = ["a person walks forward", "a person turns left", "a person bows", "a person waves"]
FEW: dict[str, Any] = {"seconds": [1, 1.5, 1, 1], "steps": 2, "seed": 4}


@pytest.mark.parametrize(
    ("changes", "made"),
    [
        ({}, ()),
        ({"texts": [*TEXTS[:2], "a person kneels", TEXTS[3]]}, (2,)),
        ({"seconds": [1, 1.5, 1.4, 1]}, (2,)),
        ({"seed": 5}, (0, 1, 2, 3)),
        ({"steps": 3}, (0, 1, 2, 3)),
        ({"guidance": 1.2}, (0, 1, 2, 3)),
        ({"foot_fix": False}, (0, 1, 2, 3)),
        # the sentences behind one that came, went or moved keep their seeds with their offsets
        ({"texts": [*TEXTS[:2], "a person kneels", *TEXTS[2:]], "seconds": 1, "seed_offsets": [0, 1, 4, 2, 3]}, (1, 2)),
        ({"texts": [*TEXTS[:2], "a person kneels", *TEXTS[2:]], "seconds": 1}, (1, 2, 3, 4)),
        ({"texts": TEXTS[1:], "seconds": FEW["seconds"][1:], "seed_offsets": [1, 2, 3]}, (0,)),  # no blend before it
        ({"texts": TEXTS[:3], "seconds": FEW["seconds"][:3]}, (2,)),  # the last part needs no time for a blend
    ],
)
def test_a_sequence_makes_only_what_changed_and_equals_one_that_makes_all(
    toy: MotionPipeline, changes: dict[str, Any], made: tuple[int, ...]
) -> None:
    memory = PartMemory()
    toy.sequence(TEXTS, **FEW, memory=memory)
    assert memory.made == (0, 1, 2, 3)
    options = {"texts": TEXTS, **FEW, **changes}
    clip = toy.sequence(**options, memory=memory)
    assert memory.made == made
    np.testing.assert_array_equal(clip.joints, toy.sequence(**options).joints)


def test_where_parts_continue_those_behind_a_change_are_made_again(toy: MotionPipeline) -> None:
    assert toy.sampler.sessions.decoder_gradients
    memory, options = PartMemory(), {**FEW, "method": "continue"}
    toy.sequence(TEXTS, **options, memory=memory)
    changed = [TEXTS[0], "a person kneels", *TEXTS[2:]]
    clip = toy.sequence(changed, **options, memory=memory)
    assert memory.made == (1, 2, 3)
    np.testing.assert_array_equal(clip.joints, toy.sequence(changed, **options).joints)


def test_a_weighted_graph_is_another_part(toy: MotionPipeline) -> None:
    memory = PartMemory()
    graph = toy.parse("a person walks slowly")
    toy.sequence([graph, TEXTS[2]], seconds=1, steps=2, seed=4, memory=memory)
    action = graph.actions[0]
    weak = replace(action.arguments[-1], weight=0.25)
    other = replace(graph, actions=(replace(action, arguments=(*action.arguments[:-1], weak)),))
    toy.sequence([other, TEXTS[2]], seconds=1, steps=2, seed=4, memory=memory)
    assert memory.made == (0,)


def test_another_pipeline_gets_nothing_of_this_one(toy: MotionPipeline) -> None:
    memory = PartMemory()
    toy.sequence(TEXTS, **FEW, memory=memory)
    toy.with_sessions(toy.sampler.sessions).sequence(TEXTS, **FEW, memory=memory)
    assert memory.made == (0, 1, 2, 3)


def test_the_memory_is_bounded_in_number_and_bytes(toy: MotionPipeline) -> None:
    clip = Clip(np.zeros((10, 22, 3), dtype=np.float32), 20.0, 1, "a person stands", "toy 1")
    few = PartMemory(2)
    for key in "abc":
        few.keep(key, clip)
        few.get("a")
    assert [few.get(key) is None for key in "abc"] == [False, True, False]
    assert few.bytes == 2 * clip.joints.nbytes
    small = PartMemory(99, most_bytes=3 * clip.joints.nbytes)
    for key in range(50):
        small.keep(key, clip)
        small.keep(key, clip)
    assert small.bytes == 3 * clip.joints.nbytes and small.get(46) is None and small.get(47) is clip
    none = PartMemory(99, most_bytes=10)
    none.keep("a", clip)
    assert none.bytes == 0 and none.get("a") is None
    with pytest.raises(InvalidInputError, match="memory is a PartMemory or None"):
        toy.sequence(TEXTS, **FEW, memory={})  # type: ignore[arg-type]


def test_what_is_remembered_asks_for_no_constraint(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    assert toy.sampler.sessions.decoder_gradients
    memory, options = PartMemory(), {"seconds": 1, "steps": 2, "seed": 4, "method": "continue"}
    made = toy.sequence(TEXTS[:2], **options, memory=memory)
    monkeypatch.setattr(clip_editing, "begin_in", lambda *_: pytest.fail("a part that is kept was prepared"))
    again = toy.sequence(TEXTS[:2], **options, memory=memory)
    assert memory.made == () and again.joints.tobytes() == made.joints.tobytes()
