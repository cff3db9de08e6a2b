"""Promise 4, bounded input: any input gives a motion or a typed error, within 5 s and 256 MB."""

from __future__ import annotations

import itertools
import json
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kinegraph import (
    Clip,
    Concept,
    EndPose,
    JointTarget,
    KinegraphError,
    Loop,
    MotionPipeline,
    SemanticGraph,
    StartPose,
    Waypoint,
    cli,
    constraints,
    edits,
)
from kinegraph.bench import GRAPH
from kinegraph.bundle.manifest import decode_manifest, seal
from kinegraph.bundle.verify import verify_bundle
from kinegraph.energy import energy_maps
from kinegraph.errors import BundleFormatError, InvalidInputError
from kinegraph.feasibility import check_constraints
from kinegraph.formats import constraints_json, read
from kinegraph.formats.npz import read_npz
from kinegraph.graph import Action, Argument
from kinegraph.limits import MAX_CONCEPTS, MAX_CONSTRAINTS, MAX_PARTS, MAX_ROWS, MAX_TAKES, MAX_TEXT
from kinegraph.motion.skeleton import JOINTS
from support.junk import HUGE, JUNK, nested
from support.shared import shared_path
from support.synthetic_bundle import manifest_object, sealed

pytest.importorskip("spacy")

MOST_SECONDS = 5.0
MOST_MEGABYTES = 256.0
FEW: dict[str, Any] = {"seconds": 1, "seed": 1, "steps": 1}


@contextmanager
def bounded(seconds: float = MOST_SECONDS) -> Iterator[Callable[[], None]]:
    """Hold a block to the limits: time of the CPU, since machines that run tests are busy, and memory at its peak.

    Yields a function that a block of many calls calls before each: memory counts from there, for who draws thousands of
    requests keeps them.
    """
    process = psutil.Process()
    before, start, done = [process.memory_info().rss], time.process_time(), threading.Event()
    most = [0]

    def watch() -> None:
        while not done.wait(0.005):
            most[0] = max(most[0], process.memory_info().rss - before[0])

    def count_from_here() -> None:
        before[0] = process.memory_info().rss

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield count_from_here
    finally:
        done.set()
        watcher.join()
    assert time.process_time() - start <= seconds
    assert most[0] / 1e6 <= MOST_MEGABYTES


# Any request

WORDS = (
    "a person walks runs forward slowly waves the left right hand and then turns without never three times two steps"
)
SENTENCES = st.lists(st.sampled_from(WORDS.split()), max_size=30).map(" ".join)
TEXTS = st.text(max_size=40) | st.text(min_size=400, max_size=600) | SENTENCES | SENTENCES.map(lambda text: text * 9)
NUMBERS = st.floats() | st.integers() | st.floats(0, 10) | st.sampled_from([1, 2, HUGE, 0.5, 100, -1])
ANYTHING = st.sampled_from(JUNK)


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


@st.composite
def requests(draw: st.DrawFn) -> tuple[str, list[Any], dict[str, Any]]:
    """A method of the pipeline with its arguments: texts or graphs (as plain values), and options."""
    inputs = TEXTS | graphs()
    call = draw(st.sampled_from(["generate", "compose", "takes", "batch", "sequence", "parse", "find_unknown"]))
    options = {
        "seconds": st.sampled_from([0.5, 1, 2, 9.8, None]) | NUMBERS,
        "seed": st.integers(0, 2**63 - 1) | NUMBERS,
        "guidance": st.floats(0, 20) | st.lists(NUMBERS, max_size=4) | NUMBERS,
        "foot_fix": st.booleans() | ANYTHING,
        "strict": st.booleans() | ANYTHING,
        "timeout": st.sampled_from([None, 60, 1e-9]) | NUMBERS | ANYTHING,
        "on_step": st.sampled_from([None, bool, lambda _: False]),
    }
    if call in ("takes", "batch"):
        options["shared_run"] = st.booleans() | ANYTHING
    if call == "compose":
        options |= {
            "lambdas": st.tuples(NUMBERS, NUMBERS, NUMBERS) | st.just((0.2, 0.1, 0.7)),
            "agd": st.just((0.1, 0.1)),
        }
        options |= {"method": st.sampled_from(["latent", "semantic", "fused", "other"])}
    chosen: dict[str, Any] = {}
    if call not in ("parse", "find_unknown"):
        steps = draw(st.sampled_from([1, 2, (1, 2, 1)]) | (NUMBERS if draw(st.integers(0, 9)) == 0 else st.just(1)))
        chosen["steps"] = steps if not isinstance(steps, int) or not 2 < steps < 999 else 2
        names = draw(st.lists(st.sampled_from(sorted(options)), unique=True, max_size=2))
        chosen |= {name: draw(options[name] if draw(st.integers(0, 9)) else ANYTHING) for name in names}
    many = draw(st.lists(inputs, max_size=3))
    if call == "compose" and draw(st.booleans()):
        return call, [[{"concept": item, "weight": draw(NUMBERS)} for item in many]], chosen
    if call == "takes":
        return call, [draw(inputs), draw(st.integers(-1, 3) | NUMBERS)], chosen
    if call in ("compose", "batch", "sequence"):
        return call, [many if draw(st.integers(0, 9)) else draw(ANYTHING)], chosen
    return call, [draw(inputs) if draw(st.integers(0, 9)) else draw(ANYTHING)], chosen


def build(value: object) -> object:
    """Make graphs and concepts of their plain values, as a caller would, also in a list; deeper lists stay."""
    return [build_one(item) for item in value] if isinstance(value, list) and len(value) < 9 else build_one(value)


def build_one(value: object) -> object:
    """Make a graph or a concept of its plain values; anything else stays."""
    if isinstance(value, dict) and "caption" in value:
        return SemanticGraph.from_dict(value)
    if isinstance(value, dict) and "concept" in value:
        return Concept(build_one(value["concept"]), value["weight"])  # type: ignore[arg-type]
    return value


def check_result(result: object) -> None:
    for clip in result if isinstance(result, list) else [result]:
        if isinstance(clip, Clip):
            assert clip.joints.shape[1:] == (JOINTS, 3) and np.isfinite(clip.joints).all()


@pytest.mark.timeout(7200)
def test_any_request_gives_a_motion_or_a_typed_error(
    toy: MotionPipeline, is_long: bool, figure: Callable[[str], None]
) -> None:
    outcomes = {"motion": 0, "error": 0}

    @settings(
        max_examples=10_000 if is_long else 120, deadline=None, database=None, suppress_health_check=[*HealthCheck]
    )
    @given(requests())
    def check(request: tuple[str, list[Any], dict[str, Any]]) -> None:
        call, arguments, options = request
        count_from_here()
        start = time.process_time()
        try:
            check_result(getattr(toy, call)(*map(build, arguments), **options))
            outcomes["motion"] += 1
        except KinegraphError as error:
            assert str(error)
            outcomes["error"] += 1
        assert time.process_time() - start <= MOST_SECONDS

    with bounded(1e9) as count_from_here:
        check()
    assert min(outcomes.values()) > sum(outcomes.values()) / 100  # both kinds were tried
    figure(f"any request: {outcomes['motion']} motions, {outcomes['error']} typed errors, nothing else")


@pytest.mark.timeout(3600)
def test_any_text_is_parsed_or_refused(toy: MotionPipeline, is_long: bool) -> None:
    @settings(max_examples=10_000 if is_long else 80, deadline=None, database=None)
    @given(TEXTS)
    def check(text: str) -> None:
        count_from_here()
        with suppress(InvalidInputError):
            assert toy.parse(text).caption == text

    with bounded(1e9) as count_from_here:
        check()


def test_long_captions_are_refused_before_they_are_parsed(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(toy.parser()), "parse_dependencies", None)
    with pytest.raises(
        InvalidInputError, match=f"a caption may have {MAX_TEXT} characters, this one has {MAX_TEXT + 1}"
    ):
        toy.parse("a" * (MAX_TEXT + 1))


# Any argument of any public function

CLIP = Clip(np.zeros((9, 22, 3), dtype=np.float32), 20.0, 1, "a person stands", "toy 1")
LONG_CLIP = Clip(np.tile(CLIP.joints[:1], (20, 1, 1)), 20.0, 1, "a person stands", "toy 1")
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
        for key in ("seconds", "seed", "steps", "guidance", "foot_fix", "strict", "timeout")
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
    "compose": lambda pipe, junk: pipe.compose(junk, **FEW),
    "compose, item": lambda pipe, junk: pipe.compose([junk], **FEW),
    **{
        f"compose, {key}": lambda pipe, junk, key=key: pipe.compose([GRAPH, GRAPH], **{**FEW, key: junk})
        for key in ("method", "text", "lambdas", "agd")
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
        for key in ("keep", "strength")
    },
    "edit, kept item": lambda pipe, junk: pipe.edit(LONG_CLIP, GRAPH, keep=[junk], steps=1),
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


@pytest.mark.parametrize("name", PUBLIC)
def test_any_argument_of_a_public_function_is_taken_or_refused(
    toy: MotionPipeline, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with bounded(60):
        for junk in JUNK:
            try:
                PUBLIC[name](toy, junk)
            except KinegraphError as error:
                assert str(error), type(junk)


# Any file of constraints

VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-5, 200) | st.sampled_from(["along", "left hand", "pelvis"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["fps", "joints"]), inner, max_size=2),
    max_leaves=12,
)
PLACES = st.lists(st.lists(st.floats(-3, 3) | VALUES, min_size=2, max_size=3), min_size=1, max_size=5)
ENTRIES = st.fixed_dictionaries(
    {"type": st.sampled_from([*constraints_json.TYPES, *constraints_json.kimodo_json.TYPES, "other"])},
    optional={
        **dict.fromkeys(("times", "heading", "weight", "anywhere", "fps", "joint", "joint_names", "more"), VALUES),
        "points": PLACES,
        "smooth_root_2d": PLACES,
        "root_positions": PLACES,
        "local_joints_rot": st.just([[[0.0] * 3] * 22] * 2) | PLACES,
        "position": st.lists(st.floats(-3, 3) | VALUES, min_size=2, max_size=3),
        "seconds": st.floats(0, 4) | VALUES,
        "joints": st.just(CLIP.joints[0].tolist()) | st.just(CLIP.joints[:4].tolist()) | VALUES,
        "frame_indices": st.just([0, 30]) | st.lists(st.integers(0, 90), min_size=1, max_size=5) | VALUES,
    },
)


@pytest.mark.timeout(3600)
def test_any_file_of_constraints_is_read_or_refused(is_long: bool) -> None:
    read_well = []

    @settings(max_examples=10_000 if is_long else 300, deadline=None, database=None)
    @given(st.lists(ENTRIES, max_size=4))
    def check(entries: list[dict[str, Any]]) -> None:
        data = json.dumps(entries).encode()
        with suppress(InvalidInputError):
            made = constraints_json.decode(constraints_json.parse(data))
            assert len(constraints_json.decode(constraints_json.parse(constraints_json.encode(made)))) == len(made)
            read_well.append(len(made))
            check_constraints(made, 80, 20)

    with bounded(1e9):
        check()
    assert any(read_well)


def test_files_of_constraints_have_limits() -> None:
    large = [b"[" * 290_000, b"[" + b"[]," * 90_000 + b"[]]", b'[{"a":' * 5000, b"[" + b'{"type": "loop"},' * 100_000]
    for data in (*large, b"9" * 7_000_000, b'["' + b"\\u" * 1_000_000, b" " * 9_000_000):
        with bounded(2), pytest.raises(InvalidInputError):
            constraints_json.decode(constraints_json.parse(data))
    most = [JointTarget("head", (None, 1.5, None), (0, 9.8))] * MAX_CONSTRAINTS
    with bounded():
        check_constraints(most, 196, 20)


# What an attack found, as kinds


@pytest.mark.parametrize("key", ["quality", "name", "levels", "fps"])
def test_manifests_nested_to_any_depth_are_refused(key: str) -> None:
    """Between what JSON's parser can follow and what `repr` can, which depends on the caller's stack."""
    body = sealed({**manifest_object(), key: "DEEP"}).rsplit(b",\n", 1)[0]
    assert body.count(b'"DEEP"') == 1
    for depth in (1, 100, *range(870, 1000, 3), 5000):
        with pytest.raises(BundleFormatError):
            decode_manifest(seal(body.replace(b'"DEEP"', b"[" * depth + b"]" * depth)))
    assert decode_manifest(seal(body.replace(b'"DEEP"', json.dumps(manifest_object()[key]).encode())))


def test_deep_values_are_described_in_few_words(toy: MotionPipeline) -> None:
    for call in (SemanticGraph.from_dict, lambda deep: toy.compose([GRAPH], lambdas=[deep] * 3, **FEW)):
        with pytest.raises(InvalidInputError):
            call(nested(100_000))


def test_the_inputs_of_the_attack_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder = shared_path("cases", "reliability")
    for name in ("npz_claims_1e13.npz", "arguments_claims_1e13.npz", "arguments_encrypted.npz"):
        assert cli.main(["view", str(folder / name), "-o", str(tmp_path / "page.html")]) == 2
    assert (
        cli.main(["generate", "--graph", str(folder / "graph_weight_400_digits.json"), "-o", str(tmp_path / "g.bvh")])
        == 2
    )
    assert capsys.readouterr().err.count("kinegraph: error:") == 4
    with pytest.raises(BundleFormatError):
        decode_manifest((folder / "manifest_deep.json").read_bytes())
    from kinegraph.text.argument_classifier import ArgumentClassifier

    for path in folder.glob("arguments_*.npz"):
        with pytest.raises(BundleFormatError):
            ArgumentClassifier(path.read_bytes())


def test_archives_of_many_members_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "many.npz", "w") as archive:
        for number in range(20_000):
            archive.writestr(f"{number}.npy", b"")
    with bounded(2), pytest.raises(InvalidInputError, match="more than 64 members"):
        read(tmp_path / "many.npz")


# The largest requests


def crowd(actions: int, weighted: int = 0, negated: int = 0) -> SemanticGraph:
    """A graph of many actions, some with weighted edges, some negated."""
    caption = " ".join(["person", *["walks"] * actions])
    nodes = tuple(
        Action("walks", 7 + 6 * n, 12 + 6 * n, n, 0.5 if n < weighted else 1.0, (), n >= actions - negated)
        for n in range(actions)
    )
    return SemanticGraph(caption, nodes)


LARGEST: dict[str, Callable[[MotionPipeline], object]] = {
    "one graph of weights": lambda pipe: pipe.generate(crowd(31, weighted=31), seconds=9.8, seed=1),
    "one graph of negations": lambda pipe: pipe.generate(crowd(31, negated=30), seconds=9.8, seed=1),
    "48 graphs": lambda pipe: pipe.compose([Concept(crowd(23, weighted=23))] * 2, method="latent", seconds=9.8, seed=1),
    "48 graphs, gradient descent": lambda pipe: pipe.compose(
        [Concept(crowd(5, weighted=5))] * MAX_CONCEPTS, method="semantic", agd=(0.1, 0.1), seconds=9.8, seed=1
    ),
    "8 fused concepts, gradient descent": lambda pipe: pipe.compose(
        [Concept(crowd(4, weighted=4))] * MAX_CONCEPTS, text=GRAPH, lambdas=(0.3, 0.3, 0.4), agd=(0.1, 0.1), seconds=9.8
    ),
    "64 clips in shared runs": lambda pipe: pipe.batch([crowd(31)] * MAX_TAKES, shared_run=True, seconds=9.8, seed=1),
    "64 takes": lambda pipe: pipe.takes(crowd(31), MAX_TAKES, seconds=9.8, seed=1),
    "256 sentences": lambda pipe: pipe.sequence([GRAPH] * MAX_PARTS, seconds=9.8, seed=1),
}
"""Names are those of the table in SECURITY.md."""
MANY = {"64 clips in shared runs": MAX_TAKES, "64 takes": MAX_TAKES, "256 sentences": MAX_PARTS}
"""Calls that make many clips, and how many: these take their time one after another."""
SECONDS_PER_CLIP = 0.4
"""Of 9.8 s; twice what a slow core needs that is busy with other things."""


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", LARGEST)
def test_the_largest_requests_stay_within_limits(
    name: str, pipe: MotionPipeline, is_long: bool, figure: Callable[[str], None]
) -> None:
    if not is_long and name not in ("48 graphs", "one graph of weights"):
        pytest.skip("in the long form: --promises=long")
    if pipe.sampler.sessions.denoiser_agd:
        pipe.compose([GRAPH, GRAPH], agd=(0.1, 0.1), **FEW)  # its sessions are opened once
    start, before = time.process_time(), psutil.Process().memory_info().rss
    with bounded(SECONDS_PER_CLIP * MANY[name] if name in MANY else MOST_SECONDS):
        check_result(LARGEST[name](pipe))
    kept = (psutil.Process().memory_info().rss - before) / 1e6
    figure(f"{name}: {time.process_time() - start:.1f} s of CPU, {kept:+.0f} MB kept")


def test_more_rows_than_a_run_takes_are_refused_before_a_model_runs(toy: MotionPipeline) -> None:
    concepts = [Concept(crowd(31, weighted=31))] * MAX_CONCEPTS
    with bounded(2), pytest.raises(InvalidInputError, match=f"{MAX_ROWS} at most share a run"):
        toy.compose(concepts, text=crowd(31, weighted=31), method="fused", agd=(0.1, 0.1), seed=1)


def test_json_of_a_graph_has_limits(toy: MotionPipeline) -> None:
    text = json.dumps({"caption": "walks", "actions": [{"text": "walks", "start": 0, "end": 5}] * 100_000})
    with bounded(2), pytest.raises(InvalidInputError):
        SemanticGraph.from_json(text)
    for text in ("[" * 100_000, "1" * 100_000, '{"a":' * 5000, "\ud800", ""):
        with pytest.raises(InvalidInputError):
            SemanticGraph.from_json(text)
