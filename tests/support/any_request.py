"""Hypothesis' strategies for any request to a pipeline: sentences, graphs, clips, constraints, options, odd values.

Graphs, concepts and constraints are drawn as plain values and made by `build`, where a caller would make them, so that
a refusal counts wherever it comes from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st

from kinegraph import Clip, Concept, EndPose, JointTarget, Loop, SemanticGraph, StartPose, Waypoint, constraints
from kinegraph.motion.skeleton import JOINT_NAMES
from support.junk import HUGE, JUNK
from support.motions import walk

Request = tuple[str, list[Any], dict[str, Any]]
"""A method of the pipeline, its arguments, and its options."""

WORDS = (
    "a person walks runs forward slowly waves the left right hand and then turns without never three times two steps"
)
SENTENCES = st.lists(st.sampled_from(WORDS.split()), max_size=30).map(" ".join)
TEXTS = st.text(max_size=40) | st.text(min_size=400, max_size=600) | SENTENCES | SENTENCES.map(lambda text: text * 9)
NUMBERS = st.floats() | st.integers() | st.floats(0, 10) | st.sampled_from([1, 2, HUGE, 0.5, 100, -1])
ANYTHING = st.sampled_from(JUNK)
NO_FUNCTION = st.sampled_from([value for value in JUNK if not callable(value)])
"""What a callback cannot be; a function that fails is its caller's, and so is its error."""

WALK = Clip(walk(30).astype(np.float32), 20.0, 1, "a person walks", "toy 1")
SHORT_CLIP = Clip(WALK.joints[:9], 20.0, 1, "a person walks", "toy 1")
LYING = np.asarray(WALK.joints[:2, :, [0, 2, 1]])
POSES = st.sampled_from([WALK, WALK, SHORT_CLIP, WALK.joints, WALK.joints[:2], LYING, 1e6 * LYING, 0 * LYING])
POSE = st.sampled_from([*WALK.joints[::7], LYING[0], 1e6 * LYING[0], WALK.joints])


def mostly(usual: st.SearchStrategy[Any], odd: st.SearchStrategy[Any] = ANYTHING) -> st.SearchStrategy[Any]:
    """Draw an odd value once in ten: with several of them nothing would get through."""
    return st.integers(0, 9).flatmap(lambda number: odd if number == 9 else usual)


PLAIN = st.sampled_from(["a person walks forward", "someone waves the left hand", "a person walks and then turns"])
METRES = mostly(st.floats(-1, 1), NUMBERS)
PAIRS = st.tuples(NUMBERS, NUMBERS)
HEADINGS = st.floats(-180, 180)
MOMENTS = mostly(st.floats(0, 1), NUMBERS | st.floats(0, 10))


@dataclass(frozen=True)
class Made:
    """A constraint that is not made yet."""

    kind: Callable[..., Any]
    fields: dict[str, Any]


def _kind(kind: Callable[..., Any], **fields: st.SearchStrategy[Any]) -> st.SearchStrategy[Made]:
    weight = mostly(st.just(1) | st.floats(0, 10), NUMBERS)
    return st.fixed_dictionaries(fields, optional={"weight": weight}).map(lambda values: Made(kind, values))


CONSTRAINTS: st.SearchStrategy[Made] = st.one_of(
    _kind(
        constraints.Path,
        points=mostly(st.lists(st.tuples(METRES, METRES), min_size=2, max_size=3), st.lists(PAIRS, max_size=5)),
        times=mostly(st.none(), st.lists(MOMENTS, max_size=5)),
        heading=mostly(st.sampled_from([None, "along"]), st.just("across") | st.lists(NUMBERS, max_size=5)),
    ),
    _kind(Waypoint, seconds=MOMENTS, position=st.tuples(METRES, METRES), heading=st.none() | mostly(HEADINGS, NUMBERS)),
    _kind(
        JointTarget,
        joint=mostly(st.sampled_from([*JOINT_NAMES, "left hand"]), st.just("tail") | ANYTHING),
        position=st.tuples(METRES, st.none() | METRES, st.none() | METRES),
        seconds=MOMENTS | st.tuples(MOMENTS, MOMENTS),
    ),
    _kind(constraints.Keyframe, seconds=MOMENTS, joints=mostly(POSE), anywhere=mostly(st.booleans())),
    _kind(StartPose, joints=mostly(POSES), fps=mostly(st.sampled_from([None, 20, 30]), NUMBERS)),
    _kind(EndPose, joints=mostly(POSES), fps=mostly(st.sampled_from([None, 20, 30]), NUMBERS)),
    _kind(Loop),
)
KEPT = mostly(st.sampled_from(["legs", "left arm", "head", (0, 0.5)]), st.tuples(MOMENTS, MOMENTS) | st.just("tail"))


@st.composite
def graphs(draw: st.DrawFn) -> object:
    """A graph with any weights, or an object that is nearly one."""
    words = draw(st.lists(st.sampled_from(WORDS.split()), min_size=1, max_size=34))
    caption, actions, start = " ".join(words), [], 0
    for word in words:
        end = start + len(word)
        node = {"text": word, "start": start, "end": end, "weight": draw(st.sampled_from([1, 1, 1, 0, 0.5, 2]))}
        if actions and draw(st.booleans()):
            actions[-1]["arguments"].append({**node, "role": "ARGM-MNR"})
        else:
            actions.append({**node, "arguments": [], "negated": draw(st.sampled_from([False, False, True]))})
        start = end + 1
    graph: dict[str, Any] = {"caption": caption, "actions": actions}
    if draw(st.integers(0, 3)) == 0:
        key = draw(st.sampled_from(["text", "start", "end", "weight", "negated", "order", "arguments", "more"]))
        draw(st.sampled_from(actions))[key] = draw(NUMBERS | ANYTHING)
    return graph


OPTIONS: dict[str, st.SearchStrategy[Any]] = {
    "seed": st.integers(0, 2**63 - 1) | NUMBERS,
    "guidance": st.floats(0, 20) | st.lists(NUMBERS, max_size=4) | NUMBERS,
    "foot_fix": st.booleans() | ANYTHING,
    "strict": st.booleans() | ANYTHING,
    "timeout": st.sampled_from([None, 60, 1e-9]) | NUMBERS | ANYTHING,
    "on_step": st.sampled_from([None, bool, lambda _: False]),
}
CONSTRAINED: dict[str, st.SearchStrategy[Any]] = {
    "constraints": st.lists(CONSTRAINTS, max_size=3) | st.lists(CONSTRAINTS, min_size=1, max_size=1),
    "constraint_weight": mostly(st.floats(0, 10), NUMBERS),
    "constraint_fix": mostly(st.booleans()),
}
SECONDS = st.sampled_from([0.5, 1, 2, 9.8, None]) | NUMBERS
MORE: dict[str, dict[str, st.SearchStrategy[Any]]] = {
    "generate": {"seconds": SECONDS, **CONSTRAINED},
    "takes": {"seconds": SECONDS, "shared_run": st.booleans() | ANYTHING, **CONSTRAINED},
    "batch": {"seconds": SECONDS, "shared_run": st.booleans() | ANYTHING, **CONSTRAINED},
    "sequence": {"seconds": SECONDS, "method": mostly(st.sampled_from(["blend", "continue"]))},
    "compose": {
        "seconds": SECONDS,
        "lambdas": st.tuples(NUMBERS, NUMBERS, NUMBERS) | st.just((0.2, 0.1, 0.7)),
        "agd": st.just((0.1, 0.1)),
        "method": st.sampled_from(["latent", "semantic", "fused", "other"]),
        **CONSTRAINED,
    },
    "edit": {"strength": mostly(st.floats(0, 1), NUMBERS), **CONSTRAINED},
    "inbetween": {"placed": mostly(st.booleans()), **CONSTRAINED},
}
"""Method -> options that not all methods have."""


@st.composite
def requests(draw: st.DrawFn) -> Request:
    """A method of the pipeline with its arguments, as plain values, and options."""
    inputs = TEXTS | graphs()
    call = draw(st.sampled_from([*MORE, "parse", "find_unknown"]))
    chosen: dict[str, Any] = {}
    if call in MORE:
        steps = draw(st.sampled_from([1, 2, (1, 2, 1)]) | (NUMBERS if draw(st.integers(0, 9)) == 0 else st.just(1)))
        chosen["steps"] = steps if not isinstance(steps, int) or not 2 < steps < 999 else 2
        options = OPTIONS | MORE[call]
        names = draw(st.lists(st.sampled_from(sorted(options)), unique=True, max_size=2))
        if "constraints" in options and draw(st.booleans()):
            inputs, names = mostly(PLAIN, inputs), [*{*names[:1], "constraints"}]
        odd = {"on_step": NO_FUNCTION}
        chosen |= {
            name: draw(options[name] if draw(st.integers(0, 9)) else odd.get(name, ANYTHING)) for name in sorted(names)
        }
    many = draw(st.lists(inputs, max_size=3))
    if call == "compose" and draw(st.booleans()):
        return call, [[{"concept": item, "weight": draw(NUMBERS)} for item in many]], chosen
    if call == "takes":
        return call, [draw(inputs), draw(st.integers(-1, 3) | NUMBERS)], chosen
    if call == "edit":
        chosen["keep"] = draw(mostly(KEPT | st.lists(KEPT, min_size=1, max_size=3)))
        return call, [draw(mostly(st.just(WALK), st.just(SHORT_CLIP) | ANYTHING)), draw(mostly(PLAIN, inputs))], chosen
    if call == "inbetween":
        seconds = draw(mostly(st.sampled_from([1, 2]), SECONDS))
        return call, [draw(mostly(POSES)), draw(POSES), seconds, draw(mostly(PLAIN, inputs))], chosen
    if call in ("compose", "batch", "sequence"):
        return call, [many if draw(st.integers(0, 9)) else draw(ANYTHING)], chosen
    return call, [draw(inputs) if draw(st.integers(0, 9)) else draw(ANYTHING)], chosen


def build(value: object) -> object:
    """Make graphs, concepts and constraints of plain values, as a caller would, also in a list; deeper ones stay."""
    return [build_one(item) for item in value] if isinstance(value, list) and len(value) < 9 else build_one(value)


def build_one(value: object) -> object:
    """Make a graph, a concept or a constraint of its plain values; anything else stays."""
    if isinstance(value, Made):
        return value.kind(**value.fields)
    if isinstance(value, dict) and "caption" in value:
        return SemanticGraph.from_dict(value)
    if isinstance(value, dict) and "concept" in value:
        return Concept(build_one(value["concept"]), value["weight"])  # type: ignore[arg-type]
    return value
