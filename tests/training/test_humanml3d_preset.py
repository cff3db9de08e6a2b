"""The preset `humanml3d` on a made HumanML3D folder: prepare, twenty steps, export, a clip, figures; data in shards."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
for needed in ("lightning", "onnxscript", "spacy"):
    pytest.importorskip(needed)

from kinegraph import MotionPipeline
from kinegraph.bundle.contract import LEVELS
from kinegraph.motion.humanml3d import humanml3d_from_joints, joints_from_humanml3d
from kinegraph_export import export_bundle
from kinegraph_training import train_denoisers, train_vae
from kinegraph_training.config import read_preset
from kinegraph_training.data.clips import StoredClips, read_split
from kinegraph_training.dataset import training_set, validation_set
from kinegraph_training.latents import read_vae
from kinegraph_training.layouts import HUMANML3D_263
from kinegraph_training.prepare import main as prepare
from kinegraph_training.stored_features import StoredFeatures
from support.evaluating import evaluate_once
from support.motions import walk
from support.published_sets import write_guo_set
from support.toy_run import ASSETS, CARD, run_stage, steps_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200), pytest.mark.usefixtures("traces")]

SMALL = """base = "humanml3d"
[vae.shared]
latent_width = 8
width = 32
layers = 1
heads = 2
feed_forward = 64
[vae.motion]
tokens = 2
width = 32
feed_forward = 64
[vae.action]
tokens = 4
width = 32
feed_forward = 64
[vae.specific]
tokens = 8
[vae_training.shared]
steps = 20
batch = 800
warmup = 2
[vae_training.specific]
steps = 20
warmup = 2
[denoiser]
width = 32
layers = 1
heads = 2
feed_forward = 64
context_layers = 1
[denoiser_training]
steps = 20
batch = 8
warmup = 2
"""
"""The preset at a size that trains in seconds."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with `data` and `run`, by the documented commands."""
    top = tmp_path_factory.mktemp("humanml3d")
    motions = {f"{n:06d}": walk(80 + 4 * n, turning=0.01 * (n - 4)) for n in range(8)}
    vectors = {f"M{n:06d}": humanml3d_from_joints(walk(90, turning=0.02 * n)) for n in range(2)}
    write_guo_set(top / "HumanML3D", motions, vectors)
    assert prepare(["--humanml3d", str(top / "HumanML3D"), "--out", str(top / "data"), "--processes", "1"]) == 0
    (top / "small.toml").write_text(SMALL)
    for level in LEVELS:
        run_stage(train_vae, top, "--level", level, preset=str(top / "small.toml"))
    run_stage(train_denoisers, top, "--assets", str(ASSETS), preset=str(top / "small.toml"))
    return top


def test_the_preset_is_ours_on_features_of_humanml3d() -> None:
    preset, edge = read_preset("humanml3d"), read_preset("edge")
    assert {config.features for config in preset.vae.values()} == {263}
    assert preset.denoiser == edge.denoiser and preset.denoiser_training == edge.denoiser_training


def test_features_are_read_from_shards_as_if_they_were_in_memory(folder: Path) -> None:
    config = read_preset("humanml3d").data
    train = training_set(folder / "data", config, None, layout=HUMANML3D_263)
    assert isinstance(train.clips, StoredClips) and isinstance(train.features, StoredFeatures)
    clips = read_split(folder / "data", "train")
    assert len(train.clips) == 2 * len(clips)
    for index, clip in enumerate(clips):
        rows = humanml3d_from_joints(clip.joints)
        assert train.lengths[index] == len(rows) == len(clip.joints) - 1
        np.testing.assert_allclose(train.features[index], (rows - train.mean) / train.std, atol=1e-4)
    rows = np.concatenate([humanml3d_from_joints(clip.joints) for clip in train.clips])
    np.testing.assert_allclose(train.mean, rows.mean(axis=0), atol=1e-4)
    val = validation_set(folder / "data", "val", config, train.mean, train.std)
    assert len(val.clips) == len(read_split(folder / "data", "val"))
    moved = train.under(train.mean + 1, train.std * 2)
    np.testing.assert_allclose(moved.features[0], (train.features[0] - 1 / train.std) / 2, atol=1e-4)
    with pytest.raises(ValueError, match="in shards, which are used as they are"):
        training_set(folder / "data", config, None, paced=True)


def test_all_stages_took_their_steps(folder: Path) -> None:
    run = folder / "run"
    assert {steps_of(run / f"vae_{level}" / "last.ckpt") for level in LEVELS} == {20}
    assert steps_of(run / "denoisers" / "last.ckpt") == 20
    assert len(read_vae(run / "vae_specific" / "last.ckpt").mean) == 263


def test_the_bundle_decodes_features_of_humanml3d_and_is_evaluated(folder: Path) -> None:
    (folder / "card.json").write_text(json.dumps(CARD))
    words = ["--run", str(folder / "run"), "--assets", str(ASSETS), "--card", str(folder / "card.json")]
    export_bundle.main([*words, "--out", str(folder / "bundle"), "--precision", "fp32"])
    pipe = MotionPipeline.load(folder / "bundle")
    assert pipe.manifest.features.layout == "humanml3d-263" and pipe.manifest.features.heading == "humanml3d"
    assert pipe.manifest.parity["pipeline_mm"] < 1.0
    clip = pipe.generate("a person walks forward", seconds=2, seed=1)
    assert clip.joints.shape == (40, 22, 3) and np.isfinite(clip.joints).all()
    assert pipe.manifest.defaults.seconds == 2.0
    assert joints_from_humanml3d(np.zeros((2, 263))).shape == (2, 22, 3)
    figures = evaluate_once(folder / "data", folder / "bundle")
    assert figures["generated"]["clips"] >= 2
    assert {"r_precision_1", "fid", "diversity"} <= set(figures["captured"]) <= set(figures["generated"]["mean"])
