"""A bundle from sentence to clip, by what its user can see."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import kinegraph
from kinegraph import MotionPipeline
from kinegraph.conditioning import ConditionEncoder
from kinegraph.diffusion.sampling import StepInfo
from kinegraph.edits import with_weight
from kinegraph.errors import Cancelled, InvalidInputError

RUNTIME = Path(kinegraph.__file__).resolve().parents[1]
pytest.importorskip("spacy")

FEW = {"motion": 2, "action": 2, "specific": 3}


def test_the_same_seed_gives_the_same_bits(toy: MotionPipeline, toy_bundle: Path) -> None:
    first = toy.generate("a person walks forward", seconds=2, seed=7, steps=FEW)
    again = toy.generate("a person walks forward", seconds=2, seed=7, steps=FEW)
    other = MotionPipeline.load(toy_bundle, threads=1).generate("a person walks forward", seconds=2, seed=7, steps=FEW)
    assert first.joints.tobytes() == again.joints.tobytes() == other.joints.tobytes()


def test_another_seed_or_sentence_gives_another_clip(toy: MotionPipeline) -> None:
    clips = [
        toy.generate(text, seconds=2, seed=seed, steps=FEW).joints
        for text, seed in (("a person walks", 1), ("a person walks", 2), ("a person waves both hands", 1))
    ]
    assert not np.allclose(clips[0], clips[1], atol=1e-3)
    assert not np.allclose(clips[0], clips[2], atol=1e-3)


def test_a_drawn_seed_repeats_its_clip(toy: MotionPipeline) -> None:
    drawn = toy.generate("a person runs", seconds=1, steps=FEW)
    again = toy.generate("a person runs", seconds=1, seed=drawn.seed, steps=FEW)
    np.testing.assert_array_equal(again.joints, drawn.joints)


@pytest.mark.parametrize("seconds", [0.8, 1.05, 3.0, 9.8])
def test_the_clip_is_as_long_as_asked(toy: MotionPipeline, seconds: float) -> None:
    clip = toy.generate("someone turns left", seconds=seconds, seed=1, steps=FEW)
    assert clip.joints.shape == (round(seconds * 20), 22, 3)
    assert clip.joints.dtype == np.float32 and np.isfinite(clip.joints).all()


def test_a_graph_is_as_good_as_its_sentence(toy: MotionPipeline) -> None:
    text = "a person walks slowly to the left"
    of_text = toy.generate(text, seconds=1, seed=3, steps=FEW)
    of_graph = toy.generate(toy.parse(text), seconds=1, seed=3, steps=FEW)
    np.testing.assert_array_equal(of_graph.joints, of_text.joints)


def test_progress_tells_every_step_and_any_step_can_stop(toy: MotionPipeline) -> None:
    seen: list[StepInfo] = []
    toy.generate("a person bows", seconds=1, seed=1, steps=FEW, on_step=lambda info: bool(seen.append(info)) or True)
    assert len(seen) == sum(FEW.values())
    for stop in range(len(seen)):
        calls: list[StepInfo] = []

        def step(info: StepInfo, calls: list[StepInfo] = calls, stop: int = stop) -> bool:
            calls.append(info)
            return len(calls) <= stop

        with pytest.raises(Cancelled):
            toy.generate("a person bows", seconds=1, seed=1, steps=FEW, on_step=step)
        assert calls == seen[: stop + 1]


def test_threads_share_a_pipeline(toy: MotionPipeline) -> None:
    def joints_of(seed: int) -> np.ndarray:
        return toy.generate("a person waves", seconds=1, seed=seed, steps=FEW).joints

    expected = {seed: joints_of(seed) for seed in range(4)}
    results = {}

    def make(seed: int) -> None:
        results[seed] = joints_of(seed)

    workers = [threading.Thread(target=make, args=(seed,)) for seed in expected]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert results.keys() == expected.keys()
    for seed, joints in expected.items():
        np.testing.assert_array_equal(results[seed], joints)


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("", {}),
        (" \n\t", {}),
        ("walk " * 2000, {}),
        ("…!?", {}),
        ("a person walks", {"seconds": float("nan")}),
        ("a person walks", {"seconds": -1}),
        ("a person walks", {"seconds": 1e9}),
        ("a person walks", {"seed": -1}),
        ("a person walks", {"steps": 0}),
        ("a person walks", {"guidance": float("inf")}),
    ],
)
def test_bad_input_is_refused_before_a_model_runs(
    toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch, text: str, options: dict[str, float]
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("a model ran")

    monkeypatch.setattr(ConditionEncoder, "encode_text", never)
    with pytest.raises(InvalidInputError):
        toy.generate(text, **options)  # type: ignore[arg-type]


def test_the_guidance_matters_and_one_is_the_conditional_alone(toy: MotionPipeline) -> None:
    strict, loose = (
        toy.generate("a person turns right", seconds=1, seed=5, steps=FEW, guidance=scale).joints for scale in (1, 4)
    )
    assert not np.allclose(strict, loose, atol=1e-4)


def with_base(toy: MotionPipeline, base: str) -> MotionPipeline:
    """The same networks, and another answer to what guidance leads away from."""
    manifest = replace(toy.manifest, defaults=replace(toy.manifest.defaults, guidance_base=base))
    encoder = toy.encoder
    return MotionPipeline(manifest, encoder.sessions, encoder.tokenizer, encoder.tables, toy.parser)


def test_what_guidance_leads_away_from_cancels_at_scale_one(toy: MotionPipeline) -> None:
    bases = [with_base(toy, base) for base in ("empty", "coarse")]
    one, other = (
        variant.generate("a person turns right", seconds=1, seed=5, steps=FEW, guidance=1).joints for variant in bases
    )
    np.testing.assert_allclose(one, other, atol=1e-4)
    one, other = (
        variant.generate("a person turns right", seconds=1, seed=5, steps=FEW, guidance=3).joints for variant in bases
    )
    assert not np.allclose(one, other, atol=1e-4)


@pytest.mark.parametrize("base", ["empty", "coarse"])
def test_a_single_concept_is_plain_guidance_whatever_it_leads_away_from(toy: MotionPipeline, base: str) -> None:
    variant, text = with_base(toy, base), "a person turns right"
    plain = variant.generate(text, seconds=1, seed=5, steps=FEW, guidance=3).joints
    composed = variant.compose([text], seconds=1, seed=5, steps=FEW, guidance=3).joints
    np.testing.assert_allclose(composed, plain, atol=1e-4)


def test_without_seconds_the_sentence_decides(toy: MotionPipeline) -> None:
    short, long = (
        toy.generate(text, seed=1, steps=FEW).frames / 20
        for text in ("a person raises the left hand", "a person walks forward, then turns left and then bows")
    )
    assert 0.8 <= short < long <= 9.8
    assert toy.compose(["a person raises the left hand"], seed=1, steps=FEW).frames / 20 == short


# A whole run of the command line that may not open a socket; prints the heavy modules that it loaded.
CLIP = """
import json, sys
def forbid(event, arguments):
    if event.startswith(("socket.connect", "socket.getaddrinfo", "urllib.")):
        raise RuntimeError(event)
sys.addaudithook(forbid)
heavy = {"torch", "onnx", "matplotlib", "transformers", "safetensors", "lightning", "scipy", "kinegraph_training"}
for name in json.loads(sys.argv[1]):
    sys.modules[name] = None  # as if not installed
from kinegraph.cli import main
assert main(["generate", *sys.argv[2:], "--quiet", "--steps", "2"]) == 0
print(json.dumps(sorted(name for name in heavy if sys.modules.get(name))))
"""


def heavy_modules(absent: list[str], arguments: list[str]) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", CLIP, json.dumps(absent), *arguments],
        env={**os.environ, "PYTHONPATH": str(RUNTIME)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.with_extras
def test_a_sentence_loads_nothing_heavy_and_asks_no_network(toy_bundle: Path, tmp_path: Path) -> None:
    # Where torch is installed, spaCy's own library loads it; what is tested is that nothing here needs it.
    target = tmp_path / "walk.npz"
    assert heavy_modules(["torch"], ["a person walks", "--bundle", str(toy_bundle), "-o", str(target)]) == []
    assert target.is_file()


@pytest.mark.with_extras
def test_a_graph_loads_nothing_heavy_even_where_torch_is_installed(
    toy: MotionPipeline, toy_bundle: Path, tmp_path: Path
) -> None:
    graph, target = tmp_path / "graph.json", tmp_path / "walk.npz"
    graph.write_text(toy.parse("a person walks").to_json(), encoding="utf-8")
    assert heavy_modules([], ["--graph", str(graph), "--bundle", str(toy_bundle), "-o", str(target)]) == []
    assert target.is_file()


class StandIn:
    """Coarse decoder that remembers the shapes of its latents and decodes zeros in their place."""

    def __init__(self, toy: MotionPipeline) -> None:
        self.toy = toy
        self.shapes: list[tuple[int, ...]] = []

    def run(self, names: list[str], feeds: dict[str, np.ndarray]) -> list[np.ndarray]:
        self.shapes.append(feeds["latent"].shape)
        finest = self.toy.manifest.levels["specific"]
        zeros = np.zeros((len(feeds["latent"]), finest.tokens, finest.latent_width), dtype=np.float32)
        outputs: list[np.ndarray] = self.toy.decoder.sessions.decoder.run(names, {**feeds, "latent": zeros})
        return outputs


@pytest.mark.parametrize("weight", [1.0, 0.5])
def test_each_coarser_level_is_shown_and_changes_nothing(toy: MotionPipeline, weight: float) -> None:
    decoder = StandIn(toy)
    opened: list[str] = []

    def open_decoder(level: str) -> StandIn:
        opened.append(level)
        return decoder

    decoders = {level: partial(open_decoder, level) for level in ("motion", "action")}
    watched = toy.with_sessions(replace(toy.decoder.sessions, coarse_decoders=decoders))  # type: ignore[arg-type]
    graph = with_weight(watched.parse("a person walks slowly"), "slowly", weight)
    wish = {"seconds": 2, "seed": 7, "steps": FEW}
    shown: list[tuple[str, kinegraph.Clip]] = []
    clip = watched.generate(graph, on_level=lambda *level: shown.append(level), **wish)
    assert [level for level, _ in shown] == ["motion", "action"] == opened
    levels = toy.manifest.levels
    assert decoder.shapes == [(1, levels[name].tokens, levels[name].latent_width) for name, _ in shown]
    for _, coarse in shown:
        assert (coarse.frames, coarse.seed, coarse.text) == (clip.frames, clip.seed, clip.text)
    assert clip.joints.tobytes() == toy.generate(graph, **wish).joints.tobytes()
    assert clip.graph == graph
    watched.generate(graph, **wish)
    assert opened == ["motion", "action"]  # not even decoded where nobody looks


def test_a_bundle_without_coarse_decoders_shows_no_level(toy: MotionPipeline) -> None:
    bare = toy.with_sessions(replace(toy.decoder.sessions, coarse_decoders={}))
    shown: list[str] = []
    bare.compose(["a person walks"], seconds=1, seed=1, steps=1, on_level=lambda level, _: shown.append(level))
    assert shown == []
