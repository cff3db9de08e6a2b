"""Skeleton space in a bundle: graphs that take any number of frames, and a bundle that stays whole where it fails."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from kinegraph.bundle.contract import FRAMES, FRAMES_DENOISER, NODE_KINDS, LevelSpec
from kinegraph.bundle.frames_part import frame_contracts
from kinegraph.bundle.reader import read_bundle
from kinegraph.errors import BundleFormatError, InvalidInputError
from kinegraph_export import add_frames as command
from kinegraph_export.add_frames import add_frames
from kinegraph_export.graphs import export_graph
from kinegraph_export.modules import DenoiserGraph
from kinegraph_export.parity import ParityError
from kinegraph_training.config import FrameConfig
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.frame_denoiser import FrameDenoiser
from kinegraph_training.models.hierarchy import Hierarchy
from support.toy import TOY_BUNDLE

CONFIG = DenoiserConfig(width=16, layers=2, heads=2, feed_forward=32, text_width=48, kind="frames", nodes_seen="all")


def write_run(folder: Path, per_token: int = 4, features: int = 137, **changes: object) -> Path:
    """Write the checkpoint of a network that nobody trained."""
    torch.manual_seed(0)
    config = DenoiserConfig(**{**asdict(CONFIG), **changes})  # type: ignore[arg-type]
    shape = LatentShape(-(-196 // per_token), per_token * features)
    weights = {f"hierarchy.{name}": value for name, value in Hierarchy(config, {FRAMES: shape}).state_dict().items()}
    settings = {"config": asdict(config), "latents": {FRAMES: asdict(shape)}, "frames": asdict(FrameConfig(per_token))}
    (folder / FRAMES).mkdir(parents=True)
    normalisation = read_bundle(TOY_BUNDLE).manifest.features
    (folder / "vae_specific").mkdir()
    state = {name: torch.tensor(getattr(normalisation, name)) for name in ("mean", "std")}
    torch.save({"state_dict": state}, folder / "vae_specific" / "last.ckpt")
    torch.save({"hyper_parameters": settings, "state_dict": weights}, folder / FRAMES / "last.ckpt")
    return folder


def test_the_step_graph_is_its_network_at_any_number_of_frames() -> None:
    torch.manual_seed(0)
    level = LevelSpec(16, 12, 16, 2, 2, NODE_KINDS[:3])
    denoiser = FrameDenoiser(CONFIG, LatentShape(16, 12)).eval()
    contract = frame_contracts(level, 48)[FRAMES_DENOISER]
    _, parity = export_graph(DenoiserGraph(denoiser.step).eval(), contract, 4, "int8")
    assert parity[FRAMES_DENOISER] < 1e-4  # six sizes, which `export_graph` compares
    assert 0 < parity[f"int8_{FRAMES_DENOISER}"] < 0.15


def test_the_toy_is_its_network() -> None:
    parity = read_bundle(TOY_BUNDLE).manifest.parity
    assert all(value < 1e-4 for name, value in parity.items() if name.startswith("frames_") and name != "frames_mm")
    assert parity["frames_mm"] < 0.1


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copytree(TOY_BUNDLE, tmp_path / "bundle")
    return tmp_path / "bundle"


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_network_that_is_not_there_or_of_another_bundle_is_refused(folder: Path, tmp_path: Path) -> None:
    before = contents(folder)
    with pytest.raises(InvalidInputError, match="train_frames"):
        add_frames(folder, tmp_path / "none")
    with pytest.raises(InvalidInputError, match="width of the text is 64 in training and 48"):
        add_frames(folder, write_run(tmp_path / "wide", text_width=64))
    with pytest.raises(InvalidInputError, match="features of a frame is 263 in training and 137"):
        add_frames(folder, write_run(tmp_path / "other", features=263))
    other = write_run(tmp_path / "normalised")
    state = torch.load(other / "vae_specific" / "last.ckpt", weights_only=True)
    torch.save({"state_dict": {**state["state_dict"], "std": torch.ones(137)}}, other / "vae_specific" / "last.ckpt")
    with pytest.raises(InvalidInputError, match="normalises features by another std"):
        add_frames(folder, other)
    assert contents(folder) == before


@pytest.mark.parametrize("after", ["export", "parity"])
def test_a_bundle_that_fails_stays_what_it_was(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: str
) -> None:
    before = contents(folder)
    stored = [before[f"{name}.onnx"] for name in command.FRAME_GRAPHS]
    made = iter([(data, {"frames_x": 0.0}) for data in stored])
    monkeypatch.setattr(command, "export_graph", lambda *_: next(made))
    measure: Callable[..., float] = lambda *_: 5.0  # noqa: E731
    monkeypatch.setattr(command, "pipeline_difference", measure)
    error: type[Exception] = ParityError if after == "parity" else BundleFormatError
    steps = 20 if after == "parity" else 10**6
    with pytest.raises(error):
        add_frames(folder, write_run(tmp_path / "run"), steps=steps)
    assert contents(folder) == before


def test_what_is_added_is_told_in_the_manifest(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stored = contents(folder)
    made = iter([(stored[f"{name}.onnx"], {name: 1e-6}) for name in command.FRAME_GRAPHS])
    monkeypatch.setattr(command, "export_graph", lambda *_: next(made))
    monkeypatch.setattr(command, "pipeline_difference", lambda *_: 0.25)
    parity = add_frames(folder, write_run(tmp_path / "run"), steps=7, guidance=1.5)
    manifest = read_bundle(folder).manifest
    assert parity["frames_mm"] == manifest.parity["frames_mm"] == 0.25 and "pipeline_mm" in manifest.parity
    part = manifest.frames_part
    assert part is not None and (part.steps, part.guidance, part.per_token, part.scale) == (7, 1.5, 4, 0.5)
    assert part.level.nodes == NODE_KINDS[:3] and np.isclose(part.level.latent_width, 548)
