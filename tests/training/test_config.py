"""Presets: read strictly, and on top of one another."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("torch")

from kinegraph.errors import InvalidInputError
from kinegraph_training.config import read_preset

COMPARISONS = Path(__file__).resolve().parents[2] / "benchmarks" / "kinegraph_benchmarks" / "ablations" / "comparisons"


@pytest.mark.parametrize("name", ["tiny", "edge", "paper"])
def test_the_packages_own_presets(name: str) -> None:
    preset = read_preset(name)
    assert preset.name == name
    # GraphMotion's numbers of latent tokens per level; twice as many in edge, whose tokens are narrower
    assert [config.tokens for config in preset.vae.values()] == ([4, 8, 16] if name == "edge" else [2, 4, 8])


def test_the_paper_preset_has_the_papers_sizes() -> None:
    paper = read_preset("paper")
    for config in paper.vae.values():
        assert (config.width, config.layers, config.heads) == (256, 9, 4)
    assert (paper.denoiser.width, paper.denoiser.layers, paper.denoiser.heads) == (256, 9, 4)


def test_a_base_is_changed_and_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('base = "edge"\nseed = 3\n[denoiser]\nlayers = 7\n[vae.motion]\ntokens = 3\n')
    mine, edge = read_preset(str(path)), read_preset("edge")
    assert (mine.name, mine.seed, mine.denoiser.layers, mine.vae["motion"].tokens) == ("mine", 3, 7, 3)
    assert mine.denoiser.width == edge.denoiser.width
    assert mine.vae["specific"] == edge.vae["specific"]
    (tmp_path / "further.toml").write_text('base = "mine.toml"\nseed = 4\n')
    further = read_preset(str(tmp_path / "further.toml"))
    assert (further.seed, further.denoiser.layers) == (4, 7)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('base = "none"', "no preset 'none'"),
        ('base = "loop.toml"', "leads back"),
        ('base = "edge"\n[denoiser]\ndepth = 3', r"\[denoiser\] has unknown keys depth"),
        ('base = "edge"\n[denoiser]\nkind = "sum"', "kind"),
        ("width =", "not TOML"),
    ],
)
def test_what_is_no_preset_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "loop.toml"
    path.write_text(text)
    with pytest.raises(InvalidInputError, match=message):
        read_preset(str(path))


@pytest.mark.parametrize("path", sorted(COMPARISONS.glob("*.toml")), ids=lambda path: path.stem)
def test_comparisons_differ_from_the_product_in_the_denoiser_alone(path: Path) -> None:
    preset, edge = read_preset(str(path)), read_preset("edge")
    assert preset.vae == edge.vae and preset.data == edge.data and preset.denoiser_training == edge.denoiser_training
    assert (preset.denoiser.width, preset.denoiser.layers) == (edge.denoiser.width, edge.denoiser.layers)
