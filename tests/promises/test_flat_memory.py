"""Promise 8, flat memory: after a warm-up, 1,000 clips of any length or sentences of new words take 5 MB at most."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import kinegraph

RUNTIME = str(Path(kinegraph.__file__).resolve().parents[1])
MOST_MEGABYTES = 5.0

CLIPS = """
import gc, json, random, sys
import psutil
from kinegraph import Concept, MotionPipeline
from kinegraph.bench import GRAPH
bundle, warm, count = sys.argv[1] or None, int(sys.argv[2]), int(sys.argv[3])
pipe = MotionPipeline.load(bundle, threads=1)
generator = random.Random(1)

def make(number):
    seconds = generator.choice([0.8, 1, 2, 3.5, 5, 9.8])
    options = {"seed": number, "seconds": seconds, "steps": 2}
    if number % 5 == 3:
        return pipe.compose([Concept(GRAPH), Concept(GRAPH, 0.5)], text=GRAPH, **options)
    if number % 5 == 4:
        return pipe.takes(GRAPH, 2, shared_run=number % 2 == 0, **options)
    return pipe.generate(GRAPH, **options)

process = psutil.Process()
for number in range(warm):
    make(number)
gc.collect()
before = process.memory_info().rss
for number in range(count):
    make(number)
gc.collect()
print(json.dumps((process.memory_info().rss - before) / 1e6))
"""

SENTENCES = """
import gc, json, random, sys
import psutil
from kinegraph import MotionPipeline
pipe = MotionPipeline.load(sys.argv[1] or None, threads=1)
generator = random.Random(1)

def word():
    return "".join(generator.choice("abcdefghijklmnopqrstuvwxyz") for _ in range(generator.randrange(5, 11)))

def parse(count):
    for _ in range(count):
        pipe.parse(f"a {word()} {word()}s to the {word()} and {word()}s")

process, strings = psutil.Process(), pipe.parser()._dependency_parser._pipeline.vocab.strings
parse(int(sys.argv[2]))
gc.collect()
before, words = process.memory_info().rss, len(strings)
parse(int(sys.argv[3]))
gc.collect()
print(json.dumps([(process.memory_info().rss - before) / 1e6, len(strings) - words]))
"""


def grow(code: str, bundle: str, warm: int, count: int) -> object:
    done = subprocess.run(
        [sys.executable, "-c", code, bundle, str(warm), str(count)],
        env={**os.environ, "PYTHONPATH": RUNTIME},
        capture_output=True,
        text=True,
        timeout=3000,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_clips_of_any_length_grow_nothing(toy_bundle: Path, is_long: bool, figure: Callable[[str], None]) -> None:
    for name, bundle in (("toy", str(toy_bundle)), ("default bundle", ""))[: 2 if is_long else 1]:
        warm, count = (200, 1000) if is_long else (60, 100)
        grown = grow(CLIPS, bundle, warm, count)
        assert isinstance(grown, float)
        figure(f"{name}: {grown:+.1f} MB over {count} clips of mixed length")
        assert grown <= MOST_MEGABYTES


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_new_words_are_forgotten(toy_bundle: Path, is_long: bool, figure: Callable[[str], None]) -> None:
    pytest.importorskip("spacy")
    warm, count = (1000, 10_000) if is_long else (50, 150)
    result = grow(SENTENCES, str(toy_bundle), warm, count)
    assert isinstance(result, list)
    grown, words = result
    figure(f"{grown:+.1f} MB and {words} words kept over {count} sentences of new words")
    assert words == 0
    assert grown <= MOST_MEGABYTES


def test_the_random_words_are_new_ones() -> None:
    """The sentences above must not run out of words: 10,000 of them have 40,000."""
    generator = random.Random(1)
    words = {
        "".join(generator.choice("abcdefghijklmnopqrstuvwxyz") for _ in range(generator.randrange(5, 11)))
        for _ in range(2000)
    }
    assert len(words) > 1990
