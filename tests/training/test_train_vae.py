"""Training of an autoencoder: starting from the weights of another, and training the decoder alone."""

from __future__ import annotations

from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from kinegraph.bundle.contract import LEVELS
from kinegraph.errors import InvalidInputError
from kinegraph_training import train_vae
from kinegraph_training.config import read_preset
from kinegraph_training.models.vae import ENCODER_PARTS, VaeConfig
from kinegraph_training.train_vae import MOTION_TERMS, VaeModule

WEIGHTS = Path(__file__).parents[2] / "weights" / "studio"


def module(seed: int) -> VaeModule:
    preset = read_preset("tiny")
    torch.manual_seed(seed)
    return VaeModule(preset.vae["specific"], preset.vae_training["specific"], [0.5 * seed] * 137, [1.0] * 137)


def logged_terms(target: VaeModule, monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Weighted terms of one training step, its first."""
    seen: dict[str, float] = {}
    monkeypatch.setattr(
        target, "log_dict", lambda values, **_: seen.update({name: value.item() for name, value in values.items()})
    )
    monkeypatch.setattr(target, "log", lambda *_, **__: None)
    target.training_step((torch.randn(2, 40, 137), torch.ones(2, 40)), 0)
    return seen


def test_weights_come_over_with_the_normalisation_that_they_are_for(tmp_path: Path) -> None:
    other, target = module(1), module(2)
    torch.save({"state_dict": other.state_dict()}, tmp_path / "other.ckpt")
    target.start_from(tmp_path / "other.ckpt")
    for name, value in target.vae.state_dict().items():
        assert torch.equal(value, other.vae.state_dict()[name]), name
    assert (target.mean == 0.5).all()


def test_who_knows_poses_is_held_to_their_motion_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = module(1)
    torch.save({"state_dict": target.state_dict()}, tmp_path / "own.ckpt")
    before = logged_terms(target, monkeypatch)
    target.start_from(tmp_path / "own.ckpt")
    after = logged_terms(target, monkeypatch)
    assert all(before[f"train/{name}"] == 0 < after[f"train/{name}"] for name in MOTION_TERMS)


def test_weights_of_another_shape_or_none_are_refused(tmp_path: Path) -> None:
    preset = read_preset("edge")
    for level in ("motion", "specific"):
        other = VaeModule(preset.vae[level], preset.vae_training[level], [0.0] * 137, [1.0] * 137)
        torch.save({"state_dict": other.state_dict()}, tmp_path / "other.ckpt")
        with pytest.raises(InvalidInputError, match="not this preset's"):
            module(1).start_from(tmp_path / "other.ckpt")
    with pytest.raises(InvalidInputError, match="no such file"):
        module(1).start_from(tmp_path / "nothing.ckpt")


def test_a_latent_of_twice_the_tokens_begins_with_each_of_them_twice(tmp_path: Path) -> None:
    preset, target = read_preset("tiny"), module(1)
    other = VaeModule(preset.vae["action"], preset.vae_training["action"], [0.0] * 137, [1.0] * 137)
    torch.save({"state_dict": other.state_dict()}, tmp_path / "other.ckpt")
    target.start_from(tmp_path / "other.ckpt")
    mean, deviation = target.vae.query[:8], target.vae.query[8:]
    for token in range(8):
        assert torch.equal(target.vae.latent_position[token], other.vae.latent_position[token // 2])
        assert torch.equal(mean[token], other.vae.query[token // 2])
        assert torch.equal(deviation[token], other.vae.query[4 + token // 2])
    # fewer tokens than there were, or a part of them more, is another network
    torch.save({"state_dict": target.state_dict()}, tmp_path / "own.ckpt")
    with pytest.raises(InvalidInputError, match="not this preset's"):
        other.start_from(tmp_path / "own.ckpt")


def test_a_decoder_alone_leaves_the_latent_where_it_was() -> None:
    target = module(1)
    target.freeze_encoder()
    features, mask = torch.randn(2, 24, 137), torch.ones(2, 24)
    latent = target.vae.encode(features, mask)
    assert not latent[0].requires_grad and not latent[1].requires_grad
    target.vae.decode(latent[0], mask).sum().backward()
    trained = {name.split(".")[0] for name, value in target.vae.named_parameters() if value.grad is not None}
    left = {name.split(".")[0] for name, value in target.vae.named_parameters() if value.grad is None}
    assert left == ENCODER_PARTS and "decoder" in trained
    with pytest.raises(InvalidInputError, match="needs --start-from"):
        train_vae.main(["--level", "specific", "--decoder-only", "--data", "x", "--run", "x"])


@pytest.mark.skipif(not WEIGHTS.is_dir(), reason="needs a checkout: weights are not in the package")
@pytest.mark.parametrize("level", LEVELS)
def test_the_weights_of_this_repository_are_the_encoders_of_the_preset(level: str) -> None:
    checkpoint = torch.load(WEIGHTS / f"vae_{level}.ckpt", weights_only=True)
    assert VaeConfig(**checkpoint["hyper_parameters"]["config"]) == read_preset("edge").vae[level]
    weights = checkpoint["state_dict"]
    assert {name.split(".")[1] for name in weights if name.startswith("vae.")} == ENCODER_PARTS
    assert {value.dtype for name, value in weights.items() if name.startswith("vae.")} == {torch.float16}
    assert all(torch.isfinite(value).all() for value in weights.values())
