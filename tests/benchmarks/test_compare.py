"""Presets of a comparison: what a variant changes, on the data and the schedule of one base, from random weights."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

from kinegraph_benchmarks.ablations import compare
from kinegraph_training.config import read_preset


@pytest.mark.parametrize("variant", sorted(path.stem for path in compare.PRESETS.glob("*.toml")))
def test_a_variant_has_the_data_and_the_budget_of_the_base(variant: str, tmp_path: Path) -> None:
    (tmp_path / "preset.toml").write_text(compare.preset_text(variant, "open", seed=3, steps=50), encoding="utf-8")
    found, base = read_preset(str(tmp_path / "preset.toml")), read_preset("open")
    own = read_preset(str(compare.PRESETS / f"{variant}.toml"))
    assert found.data == base.data and found.vae == base.vae and found.seed == 3
    assert found.denoiser == own.denoiser and found.frames == own.frames
    for training in (found.denoiser_training, found.frames_training):
        assert training.steps == 50 and training.batch == base.denoiser_training.batch
    assert compare.is_skeleton_space(variant) == (variant in ("skeleton", "mdm")) == (not found.frames.from_latent)
