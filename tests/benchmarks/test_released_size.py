"""The benchmark of released sizes: a clip is the sum of its calls, and the table says which are missing."""

from __future__ import annotations

from dataclasses import replace

import pytest

pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from kinegraph_benchmarks.speed.released_size import (
    MLD,
    RELEASED,
    clip_seconds,
    eager_arm,
    plain_arm,
    random_level,
    table,
)

LEVEL = {"times": {"eager torch": [110.0, 100.0], "ours, fp32": [40.0, 50.0], "ours, int8": [10.0, 12.0]}}


def test_a_clip_is_the_sum_of_its_calls() -> None:
    seconds = clip_seconds([LEVEL] * 3, (15, 15, 20))
    assert seconds == pytest.approx({"eager torch": 5.0, "ours, fp32": 2.0, "ours, int8": 0.5})


def test_the_table_has_a_row_for_every_model() -> None:
    mdm = {"times": {"eager torch": [90.0]}}
    networks = {
        "GraphMotion, motion": {**LEVEL, "bytes": {"int8": 238_000_000}},
        "MDM": mdm,
        "ours": {"times": {"ours, default bundle": [31.0]}},
    }
    clips = {
        "GraphMotion as released": {"steps": "15", "seconds": clip_seconds([LEVEL], [15])},
        "MDM (50 steps)": {"steps": "50", "seconds": clip_seconds([mdm], [50])},
    }
    text = table({"networks": networks, "clips": clips, "peak_mb": 900.0})
    assert "| GraphMotion as released | 15 | 1.500 |  | 0.600 | 0.150 |" in text
    assert "| MDM (50 steps) | 50 | 4.500 |  |  |  |" in text
    assert "int8: 238 MB" in text
    assert "Random weights" in text


def test_a_plain_export_predicts_what_eager_torch_does() -> None:
    torch = pytest.importorskip("torch")
    config = replace(MLD, width=32, latent_width=32, layers=3, feed_forward=64, text_width=24)
    call, inputs = random_level(config, "specific", 1, None).call
    eager, (plain, size) = eager_arm(call, inputs), plain_arm(call, inputs, 1)
    (exported,) = plain()
    assert size > 0 and torch.allclose(torch.from_numpy(exported), eager(), atol=1e-5)


def test_networks_have_the_published_sizes() -> None:
    assert (RELEASED.width, RELEASED.layers, RELEASED.heads, RELEASED.feed_forward) == (1024, 17, 16, 4096)
    denoiser = random_level(MLD, "specific", 1, None).denoiser
    assert sum(value.numel() for value in denoiser.parameters()) == pytest.approx(8.35e6, rel=0.01)
