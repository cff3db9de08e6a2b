"""Promise 6, determinism: one request gives one clip, bit for bit, and the random state of the host stays as it is."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kinegraph
from kinegraph import MotionPipeline
from kinegraph.bench import GRAPH
from kinegraph.graph import SemanticGraph
from kinegraph.options import MAX_SEED
from support.joint_hashes import joint_hashes

pytest.importorskip("spacy")

RUNTIME, TESTS = (str(path) for path in (Path(kinegraph.__file__).resolve().parents[1], Path(__file__).parents[1]))
FEW: dict[str, Any] = {"seconds": 2, "seed": 7, "steps": (2, 2, 3)}
TEXTS = ("a person walks forward", "a person waves the right hand", "someone turns left and then bows", "a person runs")
MOST = 1e-4
"""Metres by which clips differ between thread counts and neighbours, in float32."""

HASHES = """
import json, random, sys
import numpy as np
random.seed(5), np.random.seed(5)
before = random.getstate(), str(np.random.get_state())
from kinegraph import MotionPipeline
from support.joint_hashes import joint_hashes
pipe = MotionPipeline.load(sys.argv[1] if sys.argv[1:] else None)
hashes = joint_hashes(pipe)
print(json.dumps([hashes, before == (random.getstate(), str(np.random.get_state()))]))
"""


def hashes_of_a_process(*bundle: str) -> list[Any]:
    done = subprocess.run(
        [sys.executable, "-c", HASHES, *bundle],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([RUNTIME, TESTS]), "PYTHONHASHSEED": "random"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    report: list[Any] = json.loads(done.stdout)
    return report


@pytest.mark.slow
def test_processes_agree_bit_by_bit_and_leave_random_states_alone(toy_bundle: Path, is_long: bool) -> None:
    bundles: list[list[str]] = [[str(toy_bundle)], []] if is_long else [[str(toy_bundle)]]
    for bundle in bundles:
        reports = [hashes_of_a_process(*bundle) for _ in range(3 if is_long else 2)]
        assert all(report == reports[0] for report in reports)
        assert reports[0][1], "the first sentence of a process changes Python's or NumPy's random state"


def test_the_real_bundle_repeats_itself_and_every_parse_leaves_random_states_alone(pipe: MotionPipeline) -> None:
    random.seed(3)
    np.random.seed(3)  # noqa: NPY002 - the legacy state is what hosts may use
    states = random.getstate(), str(np.random.get_state())  # noqa: NPY002
    first = pipe.generate(TEXTS[0], **FEW)
    pipe.parse("a person spins around zigzagging")
    pipe.compose([TEXTS[0], TEXTS[1]], **FEW)
    assert states == (random.getstate(), str(np.random.get_state()))  # noqa: NPY002
    pipe.generate(TEXTS[1], **FEW)
    np.testing.assert_array_equal(pipe.generate(TEXTS[0], **FEW).joints, first.joints)


def test_another_pipeline_gives_the_same_bits(toy: MotionPipeline, toy_bundle: Path) -> None:
    assert joint_hashes(MotionPipeline.load(toy_bundle, threads=1)) == joint_hashes(toy)


def test_thread_counts_differ_by_rounding(toy: MotionPipeline, toy_bundle: Path, figure: Callable[[str], None]) -> None:
    two = MotionPipeline.load(toy_bundle, threads=2)
    largest = max(
        float(np.abs(two.generate(text, **FEW).joints - toy.generate(text, **FEW).joints).max()) for text in TEXTS
    )
    figure(f"one and two threads, float32: {largest * 1000:.4f} mm")
    assert largest <= MOST


@pytest.mark.parametrize("position", range(4))
def test_neighbours_in_a_shared_run_differ_by_rounding(toy: MotionPipeline, position: int) -> None:
    graphs: list[str | SemanticGraph] = list(TEXTS)
    graphs[position] = GRAPH
    seed = FEW["seed"] + position
    together = toy.batch(graphs, shared_run=True, **FEW)[position]
    alone = toy.generate(GRAPH, **{**FEW, "seed": seed})
    assert float(np.abs(together.joints - alone.joints).max()) <= MOST
    apart = toy.batch(graphs, **FEW)[position]
    np.testing.assert_array_equal(apart.joints, alone.joints)


@pytest.mark.parametrize("seed", [0, 1, 2**32, MAX_SEED - 1])
def test_a_seed_is_all_that_noise_depends_on(toy: MotionPipeline, seed: int) -> None:
    options = {**FEW, "seed": seed}
    random.seed(seed)
    first = toy.generate(GRAPH, **options).joints
    random.seed(1)
    np.testing.assert_array_equal(toy.generate(GRAPH, **options).joints, first)
    assert not np.array_equal(toy.generate(GRAPH, **{**FEW, "seed": seed ^ 1}).joints, first)
