"""Two texts in order by every method: lengths, limits of captured motion, and the table."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph_benchmarks.common.two_action_scores import transition_distance
from kinegraph_benchmarks.common.two_action_set import TwoActionClip
from kinegraph_benchmarks.quality import temporal_composition as temporal
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.synthetic.compositions import BLEND, stitch_clips
from support.motions import stand, walk


class Evaluator:
    version = "by hand"

    def embed_motions(self, clips: list[np.ndarray]) -> np.ndarray:
        return np.array([[np.ptp(joints[:, 0, 2]), joints[:, 15, 1].min()] for joints in clips], dtype=np.float32)

    def embed_captions(self, captions: list[str]) -> np.ndarray:
        return np.array([[3.0, 1.4] if "walks" in caption else [0.0, 1.0] for caption in captions], dtype=np.float32)


def item(first: np.ndarray, second: np.ndarray) -> TwoActionClip:
    texts = ("a person walks forward", "a person bows")
    joined = stitch_clips(first, second)
    caption = f"{texts[0]} and then bows"
    return TwoActionClip("in_order", ("walk", "bow"), "normal", caption, texts, (first, second), joined, False)


ITEMS = [item(walk(40), stand(40, bow=1.0)), item(walk(44, speed=0.06), stand(36, bow=0.8))]
CLIPS = [MotionClip("walk", walk(60), ("a person walks",), ("walk",), "normal")]


def test_the_limit_is_that_of_windows_of_captured_motion() -> None:
    limit = temporal.captured_limit(CLIPS)
    windows = [transition_distance(walk(60)[start : start + 2 * BLEND + 1], BLEND) for start in range(44)]
    assert min(windows) <= limit <= max(windows) * 1.05
    jump = walk(60)
    jump[30:, 20, 1] += 20.0
    whole = replace(ITEMS[0], parts=(walk(34), walk(34)), joints=jump)
    assert temporal.share_within([whole, whole], [walk(60), jump], 1.5 * limit) == 0.5


def test_every_method_makes_motions_as_long_as_the_captured_ones(toy: MotionPipeline) -> None:
    pytest.importorskip("spacy")
    evaluator: Any = Evaluator()
    result = temporal.measure(toy, CLIPS, ITEMS, 1, evaluator)
    alone = ["each alone, latent", "each alone, skeleton"]
    assert list(result["rows"]) == ["captured, joined", *alone, "one sentence", "blend", "continue", "energy"]
    for method in list(result["rows"])[1:]:
        frames = len(temporal.make_pair(toy, ITEMS[0], method, 3))
        assert frames == 72 or (method == "blend" and 62 <= frames <= 72), method
        assert result["rows"][method]["transition_distance"]["mean"] > 0
    table = temporal.markdown_table(result)
    assert "| crop r precision 1 |" in table and "| energy | " in table and "2 captions of two actions" in table
    limits = toy.manifest.seconds_limits
    manifest = SimpleNamespace(name="bare", version="1", frames_part=None, seconds_limits=limits)
    calls = {name: getattr(toy, name) for name in ("sequence", "compose", "generate")}
    bare: Any = SimpleNamespace(manifest=manifest, **calls)
    assert not {"energy", alone[1]} & set(temporal.measure(bare, CLIPS, ITEMS, 1, evaluator)["rows"])


def test_parts_alone_are_joined_as_captured_ones() -> None:
    captured = dict(zip(ITEMS[0].texts, ITEMS[0].parts, strict=True))
    seeds: list[int] = []

    def generate(text: str, *, seconds: float, seed: int, **how: Any) -> SimpleNamespace:
        seeds.append(seed)
        assert round(20 * seconds) == len(captured[text])
        return SimpleNamespace(joints=captured[text])

    pipe: Any = SimpleNamespace(generate=generate, manifest=SimpleNamespace(seconds_limits=(0.8, 9.8)))
    made = temporal.make_pair(pipe, ITEMS[0], "each alone, skeleton", 6)
    np.testing.assert_array_equal(made, ITEMS[0].joints)
    assert seeds == [6, 7]
