"""All public functions, each argument of each by name: calls that take one value where that argument stands."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from kinegraph import (
    Clip,
    Concept,
    EndPose,
    JointTarget,
    Loop,
    MotionPipeline,
    SemanticGraph,
    StartPose,
    Waypoint,
    constraints,
    edits,
)
from kinegraph.bench import GRAPH
from kinegraph.bundle.verify import verify_bundle
from kinegraph.energy import energy_maps
from kinegraph.feasibility import check_constraints
from kinegraph.formats import constraints_json, read
from kinegraph.formats.npz import read_npz
from kinegraph.graph import Action, Argument
from kinegraph.intervals import Interval
from kinegraph.layers import Layer
from kinegraph.timeline import generate_timeline

FEW: dict[str, Any] = {"seconds": 1, "seed": 1, "steps": 1}
CLIP = Clip(np.zeros((9, 22, 3), dtype=np.float32), 20.0, 1, "a person stands", "toy 1")
LONG_CLIP = Clip(np.tile(CLIP.joints[:1], (20, 1, 1)), 20.0, 1, "a person stands", "toy 1")
INTERVALS = [Interval(GRAPH, 0, 1), Interval(GRAPH, 1, 2)]
FIELDS: dict[str, Any] = {"joints": CLIP.joints, "fps": 20, "seed": 1, "text": "a", "bundle": "b"}
EXTRA_FIELDS = ("graph", "unknown", "notes", "misses")
CONSTRAINT_FIELDS: dict[Callable[..., Any], dict[str, Any]] = {
    constraints.Path: {"points": [[0, 0], [0, 1]], "times": None, "heading": None, "weight": 1},
    Waypoint: {"seconds": 1, "position": (0, 1), "heading": None, "weight": 1},
    JointTarget: {"joint": "head", "position": (0, 1, 0), "seconds": 1, "weight": 1},
    constraints.Keyframe: {"seconds": 1, "joints": CLIP.joints[0], "weight": 1, "anywhere": False},
    StartPose: {"joints": CLIP, "weight": 1, "fps": None},
    EndPose: {"joints": CLIP.joints, "weight": 1, "fps": 20},
    Loop: {"weight": 1},
}
PUBLIC: dict[str, Callable[[MotionPipeline, Any], object]] = {
    "load": lambda _, junk: MotionPipeline.load(junk) if junk is not None else None,
    "load, threads": lambda pipe, junk: MotionPipeline.load("nowhere", threads=junk),
    "verify": lambda _, junk: verify_bundle(junk) if junk is not None else None,
    "graph, caption": lambda _, junk: SemanticGraph(junk, GRAPH.actions),
    "graph, actions": lambda _, junk: SemanticGraph("walks", junk),
    "graph, action": lambda _, junk: SemanticGraph("walks", (junk,)),
    "from_json": lambda _, junk: SemanticGraph.from_json(junk),
    "from_dict": lambda _, junk: SemanticGraph.from_dict(junk),
    "from_dict, actions": lambda _, junk: SemanticGraph.from_dict({"caption": "walks", "actions": junk}),
    "from_dict, action": lambda _, junk: SemanticGraph.from_dict({"caption": "walks", "actions": [junk]}),
    **{
        f"action, {key}": lambda _, junk, key=key: SemanticGraph(
            "walks", (Action(**{"text": "walks", "start": 0, "end": 5, "order": 0, key: junk}),)
        )
        for key in ("text", "start", "end", "order", "weight", "arguments", "negated")
    },
    **{
        f"argument, {key}": lambda _, junk, key=key: SemanticGraph(
            "walks",
            (
                Action(
                    "walks",
                    0,
                    5,
                    0,
                    1.0,
                    (Argument(**{"role": "ARG0", "text": "w", "start": 0, "end": 1, key: junk}),),
                ),
            ),
        )
        for key in ("role", "text", "start", "end", "weight")
    },
    "concept": lambda _, junk: Concept(junk),
    "concept, weight": lambda _, junk: Concept("a person walks", junk),
    **{f"clip, {key}": lambda _, junk, key=key: Clip(**{**FIELDS, key: junk}) for key in (*FIELDS, *EXTRA_FIELDS)},
    **{
        f"{kind.__name__}, {key}": lambda _, junk, kind=kind, fields=fields, key=key: kind(**{**fields, key: junk})
        for kind, fields in CONSTRAINT_FIELDS.items()
        for key in fields
    },
    "keyframe of": lambda _, junk: constraints.Keyframe.of(junk, 0),
    "keyframe of, seconds": lambda _, junk: constraints.Keyframe.of(CLIP, junk),
    "check_constraints": lambda _, junk: check_constraints(junk, 80, 20),
    "check_constraints, item": lambda _, junk: check_constraints([junk], 80, 20),
    "constraints_json": lambda _, junk: constraints_json.decode(junk),
    "constraints_json, entry": lambda _, junk: constraints_json.decode([junk]),
    "constraints_json, type": lambda _, junk: constraints_json.decode([{"type": junk}]),
    "constraints_json, file": lambda _, junk: constraints_json.read(junk),
    "resampled": lambda _, junk: CLIP.resampled(junk),
    "looped": lambda _, junk: CLIP.looped(foot_fix=junk),
    "save": lambda _, junk: CLIP.save(junk),
    "save, names": lambda _, junk: CLIP.save("/nowhere/a.bvh", names=junk),
    "save, force": lambda _, junk: CLIP.save("/nowhere/a.bvh", force=junk),
    "save, root": lambda _, junk: CLIP.save("/nowhere/a.bvh", root=junk),
    "read": lambda _, junk: read(junk),
    "read, suffix": lambda _, junk: read("/nowhere/a.npz", suffix=junk),
    "read_npz": lambda _, junk: read_npz(junk),
    "without": lambda _, junk: edits.without(GRAPH, junk),
    "with_weight": lambda _, junk: edits.with_weight(GRAPH, junk, 2.0),
    "with_weight, weight": lambda _, junk: edits.with_weight(GRAPH, 1, junk),
    "replaced": lambda _, junk: edits.replaced(GRAPH, junk, "runs"),
    "replaced, text": lambda _, junk: edits.replaced(GRAPH, 1, junk),
    "with_action": lambda _, junk: edits.with_action(GRAPH, junk),
    "with_argument": lambda _, junk: edits.with_argument(GRAPH, junk, "ARG1", "x"),
    "with_argument, role": lambda _, junk: edits.with_argument(GRAPH, 1, junk, "x"),
    "with_argument, text": lambda _, junk: edits.with_argument(GRAPH, 1, "ARG1", junk),
    "parse": lambda pipe, junk: pipe.parse(junk),
    "find_unknown": lambda pipe, junk: pipe.find_unknown(junk),
    "generate": lambda pipe, junk: pipe.generate(junk, **FEW),
    **{
        f"generate, {key}": lambda pipe, junk, key=key: pipe.generate(GRAPH, **{**FEW, key: junk})
        for key in ("seconds", "seed", "steps", "guidance", "space", "foot_fix", "strict", "timeout")
    },
    **{
        f"generate, {key}": lambda pipe, junk, key=key: (
            None if callable(junk) else pipe.generate(GRAPH, **FEW, **{key: junk})
        )
        for key in ("on_step", "on_level")
    },
    "takes": lambda pipe, junk: pipe.takes(GRAPH, junk, **FEW),
    "batch": lambda pipe, junk: pipe.batch(junk, **FEW),
    "batch, item": lambda pipe, junk: pipe.batch([junk], **FEW),
    "batch, seconds": lambda pipe, junk: pipe.batch([GRAPH], **{**FEW, "seconds": junk}),
    "sequence": lambda pipe, junk: pipe.sequence(junk, **FEW),
    "sequence, memory": lambda pipe, junk: pipe.sequence([GRAPH, GRAPH], memory=junk, **FEW),
    "sequence, method": lambda pipe, junk: pipe.sequence([GRAPH, GRAPH], method=junk, **FEW),
    **{
        f"sequence, {key}": lambda pipe, junk, key=key: pipe.sequence([GRAPH, GRAPH], **{**FEW, key: junk})
        for key in ("seconds", "seed", "seed_offsets", "strict", "timeout")
    },
    "takes, shared_run": lambda pipe, junk: pipe.takes(GRAPH, 2, shared_run=junk, **FEW),
    "batch, takes": lambda pipe, junk: pipe.batch([GRAPH], takes=junk, **FEW),
    "masked": lambda _, junk: edits.masked(GRAPH, junk),
    "generate_timeline": lambda pipe, junk: generate_timeline(pipe, junk, **FEW),
    **{
        f"generate_timeline, {key}": lambda pipe, junk, key=key: generate_timeline(
            pipe, [GRAPH, GRAPH], **{**FEW, key: junk}
        )
        for key in (
            *("seconds", "constraints", "constraint_weight", "seed", "seed_offsets", "steps", "guidance", "foot_fix"),
            *("strict", "timeout", "memory"),
        )
    },
    "generate_timeline, constraint": lambda pipe, junk: generate_timeline(pipe, [GRAPH], constraints=[junk], **FEW),
    "timeline, layers": lambda pipe, junk: generate_timeline(pipe, [GRAPH], layers=junk, **FEW),
    "timeline, layer": lambda pipe, junk: generate_timeline(pipe, [GRAPH], layers=[junk], **FEW),
    "intervals": lambda pipe, junk: pipe.timeline(junk, steps=1),
    "intervals, overlap": lambda pipe, junk: pipe.timeline(INTERVALS, overlap=junk, space="frames", steps=1),
    **{
        f"interval, {key}": lambda _, junk, key=key: Interval(**{"text": GRAPH, "start": 0, "end": 1, key: junk})
        for key in ("text", "start", "end", "parts")
    },
    "layer": lambda pipe, junk: Layer(junk, 0, 1),
    "layer, begin": lambda pipe, junk: Layer(GRAPH, junk, 1),
    "layer, weight": lambda pipe, junk: Layer(GRAPH, 0, 1, junk),
    "compose": lambda pipe, junk: pipe.compose(junk, **FEW),
    "compose, item": lambda pipe, junk: pipe.compose([junk], **FEW),
    **{
        f"compose, {key}": lambda pipe, junk, key=key: pipe.compose([GRAPH, GRAPH], **{**FEW, key: junk})
        for key in ("method", "text", "lambdas", "agd", "seconds", "seed", "space", "constraints", "constraint_weight")
    },
    "generate, constraints": lambda pipe, junk: pipe.generate(GRAPH, constraints=junk, **FEW),
    "generate, constraint": lambda pipe, junk: pipe.generate(GRAPH, constraints=[junk], **FEW),
    **{
        f"generate, {key}": lambda pipe, junk, key=key: pipe.generate(
            GRAPH, constraints=[Waypoint(0.5, (0, 1))], **FEW, **{key: junk}
        )
        for key in ("constraint_weight", "constraint_fix")
    },
    "edit": lambda pipe, junk: pipe.edit(junk, GRAPH, keep="legs"),
    **{
        f"edit, {key}": lambda pipe, junk, key=key: pipe.edit(
            LONG_CLIP, GRAPH, **{"keep": "legs", "steps": 1, key: junk}
        )
        for key in ("keep", "strength", "space", "constraint_weight", "constraint_fix")
    },
    "edit, text": lambda pipe, junk: pipe.edit(LONG_CLIP, junk, keep="legs", steps=1),
    "inbetween, text": lambda pipe, junk: pipe.inbetween(CLIP, CLIP, 1, junk, steps=1),
    "edit, kept item": lambda pipe, junk: pipe.edit(LONG_CLIP, GRAPH, keep=[junk], steps=1),
    "edit in skeleton space": lambda pipe, junk: pipe.edit(LONG_CLIP, GRAPH, keep=junk, space="frames", steps=1),
    "edit, span": lambda pipe, junk: pipe.edit(LONG_CLIP, GRAPH, keep=[(0, junk)], steps=1),
    **{
        f"inbetween, {key}": lambda pipe, junk, key=key: pipe.inbetween(
            **{"start": CLIP, "end": CLIP, "seconds": 1, "text": GRAPH, "steps": 1, key: junk}
        )
        for key in ("start", "end", "seconds", "placed", "constraints")
    },
    "stream": lambda pipe, junk: list(itertools.islice(pipe.stream(junk, steps=1), 1)),
    "stream, seconds": lambda pipe, junk: next(pipe.stream([GRAPH], seconds=junk, steps=1)),
    "energy_maps": lambda pipe, junk: energy_maps(pipe, junk, **FEW),
}
