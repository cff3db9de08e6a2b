"""The benchmark of a whole bundle of released size, at a small size: all arms make clips, and all is measured."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from kinegraph_benchmarks.speed import released_bundle
from kinegraph_benchmarks.speed.released_bundle import ARMS, EagerClip, Sizes

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900), pytest.mark.usefixtures("traces")]


def test_all_arms_are_measured_in_one_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.json"
    released_bundle.main(["--work", str(tmp_path / "work"), "--out", str(out), "--quick", "--threads", "1"])
    result = json.loads(out.read_text())
    assert set(result["times"]) == set(result["peak_mb"]) == set(ARMS)
    assert all(len(values) == 2 and min(values) > 0 for values in result["times"].values())
    assert min(result["peak_mb"].values()) > 50 and set(result["bytes"]) == {"ours, int8", "ours, fp32"}
    assert "| eager torch |" in capsys.readouterr().out


def test_sizes_are_those_of_the_release() -> None:
    sizes = Sizes.released()
    assert (sizes.denoiser.width, sizes.denoiser.layers, sizes.vae.layers, sizes.clip.width) == (1024, 17, 9, 768)
    features = EagerClip(Sizes.quick(), (1, 1, 1))()
    assert features.shape == (1, released_bundle.FRAMES, 263) and bool(features.isfinite().all())
