"""Presets and table of the comparison over latent tokens; the training it starts is tested with the stages."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

from kinegraph_benchmarks.ablations import latent_tokens
from kinegraph_training.config import read_preset


@pytest.mark.parametrize("tokens", [2, 16])
def test_only_the_number_of_tokens_and_the_budget_change(tokens: int, tmp_path: Path) -> None:
    options = argparse.Namespace(seed=3, vae_steps=20, steps=10)
    (tmp_path / "preset.toml").write_text(latent_tokens.preset_toml(tokens, options))
    found, edge = read_preset(str(tmp_path / "preset.toml")), read_preset("edge")
    assert found.vae["specific"].tokens == tokens and found.denoiser.levels == ("specific",)
    assert found.vae_training["specific"].steps == 20 and found.denoiser_training.steps == 10
    assert found.vae["action"] == edge.vae["action"] and found.vae["specific"].width == edge.vae["specific"].width
    assert found.data == edge.data


def test_a_line_of_the_table_is_one_number_of_tokens() -> None:
    kept = {name: dict.fromkeys(latent_tokens.RECONSTRUCTION_METRICS, 1.5) for name in latent_tokens.SPLITS}
    means = {name: {"mean": 0.25} for name in latent_tokens.GENERATION_METRICS}
    made = {"splits": {name: {"generated": {"mean": means}} for name in latent_tokens.SPLITS}}
    lines = latent_tokens.markdown_table({4: {"reconstruction": kept, "generated": made}}).splitlines()
    rows = [line for line in lines if line.startswith("| 4 |")]
    assert rows == ["| 4 | 1.5 | 1.5 | 1.5 | 1.5" + " | 0.25" * len(latent_tokens.GENERATION_METRICS) + " |"] * 2
