"""Promise 4, bounded input: any input gives a motion or a typed error, within 5 s and 256 MB."""

from __future__ import annotations

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
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from kinegraph import Clip, Concept, JointTarget, KinegraphError, MotionPipeline, SemanticGraph, cli
from kinegraph.bench import GRAPH
from kinegraph.bundle.manifest import decode_manifest, seal
from kinegraph.errors import BundleFormatError, InvalidInputError
from kinegraph.feasibility import check_constraints
from kinegraph.formats import constraints_json, read
from kinegraph.graph import Action
from kinegraph.limits import MAX_CONCEPTS, MAX_CONSTRAINTS, MAX_PARTS, MAX_ROWS, MAX_TAKES, MAX_TEXT
from kinegraph.motion.skeleton import JOINTS
from support.any_request import TEXTS, Request, build, requests
from support.junk import JUNK, nested
from support.public_functions import CLIP, FEW, PUBLIC
from support.shared import shared_path
from support.synthetic_bundle import manifest_object, sealed

pytest.importorskip("spacy")

MOST_SECONDS = 5.0
SECONDS_PER_CLIP = 0.4
"""Of 9.8 s, in calls that make many clips; twice what a slow core needs that is busy with other things."""
MOST_MEGABYTES = 256.0


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


def check_result(result: object) -> int:
    """Check that clips are motions; returns how many there are."""
    clips = [clip for clip in (result if isinstance(result, list) else [result]) if isinstance(clip, Clip)]
    assert all(clip.joints.shape[1:] == (JOINTS, 3) and np.isfinite(clip.joints).all() for clip in clips)
    return len(clips)


@pytest.mark.timeout(7200)
def test_any_request_gives_a_motion_or_a_typed_error(
    toy: MotionPipeline, is_long: bool, figure: Callable[[str], None]
) -> None:
    outcomes = dict.fromkeys(("motion", "error", "constrained", "edit", "inbetween"), 0)

    @settings(
        max_examples=10_000 if is_long else 120, deadline=None, database=None, suppress_health_check=[*HealthCheck]
    )
    @given(requests())
    def check(request: Request) -> None:
        call, arguments, options = request
        count_from_here()
        start, clips = time.process_time(), 0
        try:
            built = {name: build(value) for name, value in options.items()}
            clips = check_result(getattr(toy, call)(*map(build, arguments), **built))
        except KinegraphError as error:
            assert str(error)
            outcomes["error"] += 1
        else:
            is_constrained = bool(isinstance(options.get("constraints"), list) and options["constraints"])
            for kind in ("motion", call, *["constrained"][:is_constrained]):
                outcomes[kind] = outcomes.get(kind, 0) + 1
        assert time.process_time() - start <= max(MOST_SECONDS, SECONDS_PER_CLIP * clips)

    with bounded(1e9) as count_from_here:
        check()
    both = (outcomes["motion"], outcomes["error"])
    assert min(both) > sum(both) / 100  # both kinds were tried
    assert not is_long or min(outcomes.values()) > 10
    made = ", ".join(f"{outcomes[kind]} {kind}" for kind in ("constrained", "edit", "inbetween"))
    figure(f"any request: {both[0]} motions ({made}), {both[1]} typed errors, nothing else")


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
    @example([{"type": "waypoint", "position": [0.0, 1.0], "seconds": 1.0}])  # few drawn ones are right
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
        with bounded(), pytest.raises(InvalidInputError):
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
    with bounded(), pytest.raises(InvalidInputError, match="more than 64 members"):
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
    with bounded(), pytest.raises(InvalidInputError, match=f"{MAX_ROWS} at most share a run"):
        toy.compose(concepts, text=crowd(31, weighted=31), method="fused", agd=(0.1, 0.1), seed=1)


def test_json_of_a_graph_has_limits(toy: MotionPipeline) -> None:
    text = json.dumps({"caption": "walks", "actions": [{"text": "walks", "start": 0, "end": 5}] * 100_000})
    with bounded(), pytest.raises(InvalidInputError):
        SemanticGraph.from_json(text)
    for text in ("[" * 100_000, "1" * 100_000, '{"a":' * 5000, "\ud800", ""):
        with pytest.raises(InvalidInputError):
            SemanticGraph.from_json(text)
