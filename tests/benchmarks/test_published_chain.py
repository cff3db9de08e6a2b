"""From the published folders to figures by documented commands: prepare, twenty steps, export, evaluate.

Exporting takes most of a minute. KINEGRAPH_LONG=1 evaluates the bundle of every training; else that of the toy is
evaluated in its place, and the whole way is gone on HumanML3D alone (`training/test_humanml3d_preset.py`).
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
for needed in ("lightning", "onnxscript", "spacy", "tqdm"):
    pytest.importorskip(needed)

from kinegraph import MotionPipeline
from kinegraph.bundle.contract import LEVELS
from kinegraph_benchmarks.quality import evaluate
from kinegraph_export import clip_text_encoder, export_bundle
from kinegraph_training import train_denoisers, train_vae
from kinegraph_training.prepare import main as prepare
from support.evaluating import evaluate_once
from support.motions import walk
from support.official import write_clip
from support.published_sets import amass_arrays, write_body_model, write_bones_seed, write_guo_set
from support.toy import with_parser
from support.toy_run import ASSETS, CARD, run_stage, steps_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]
IS_LONG = bool(os.environ.get("KINEGRAPH_LONG"))
SETS = ("kit", "bones-seed", "amass", *(["humanml3d"] if IS_LONG else []))
TWENTY_STEPS = """base = "tiny"
[vae.shared]
layers = 1
[vae_training.shared]
steps = 20
[denoiser]
layers = 1
[denoiser_training]
steps = 20
"""


def write_set(name: str, top: Path) -> list[str]:
    """Write a made data set in its published layout; returns the options that prepare it."""
    folder = top / "published"
    if name == "bones-seed":
        days = {f"2207{day}/{action}_00{day}__A001": 480 for day in range(10, 18) for action in ("walk", "jump")}
        write_bones_seed(folder, days)
        return ["--bones-seed", str(folder), "--splits", str(folder / "splits")]
    if name == "amass":
        captions = []
        for number in range(12):
            file = f"CMU/{number:02d}/{number:02d}_01_poses"
            (folder / file).parent.mkdir(parents=True)
            np.savez(folder / f"{file}.npz", **amass_arrays(240 + 24 * number, 120))
            captions.append(f"{file}.npz,a person walks and waves\n")
        write_body_model(top / "models")
        (top / "captions.csv").write_text("".join(captions))
        return ["--amass", str(folder), "--body-models", str(top / "models"), "--captions", str(top / "captions.csv"),
                "--val", "0.2", "--test", "0.3"]  # fmt: skip
    joints = 22 if name == "humanml3d" else 21
    scale = 1.0 if name == "humanml3d" else 500.0
    motions = {f"{n:06d}": scale * walk(80 + 4 * n, turning=0.01 * (n - 4))[:, :joints] for n in range(8)}
    write_guo_set(folder, motions, {})
    (folder / "test.txt").write_text("000006\n000007\n")
    (folder / "train.txt").write_text("".join(f"{n:06d}\n" for n in range(5)))
    (folder / "val.txt").write_text("000005\n")
    return [f"--{name}", str(folder)]


def train(top: Path, assets: Path, preset: str) -> None:
    """Train all stages on `data` for twenty steps each."""
    (top / "twenty.toml").write_text(preset)
    for level in LEVELS:
        run_stage(train_vae, top, "--level", level, preset=str(top / "twenty.toml"))
    run_stage(train_denoisers, top, "--assets", str(assets), preset=str(top / "twenty.toml"))
    stages = (*(f"vae_{level}" for level in LEVELS), "denoisers")
    assert {steps_of(top / "run" / stage / "last.ckpt") for stage in stages} == {20}


def export(top: Path, assets: Path) -> Path:
    """Export the run; the bundle makes a clip."""
    (top / "card.json").write_text(json.dumps(CARD))
    words = ["--run", top / "run", "--assets", assets, "--card", top / "card.json", "--out", top / "bundle"]
    export_bundle.main([*map(str, words), "--precision", "fp32"])
    joints = MotionPipeline.load(top / "bundle").generate("a person walks", seconds=2, seed=1).joints
    assert joints.shape == (40, 22, 3) and np.isfinite(joints).all()
    return top / "bundle"


@pytest.mark.parametrize("name", SETS)
def test_from_a_published_folder_to_figures(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert prepare([*write_set(name, tmp_path), "--out", str(tmp_path / "data"), "--processes", "1"]) == 0
    train(tmp_path, ASSETS, TWENTY_STEPS)
    bundle = export(tmp_path, ASSETS) if IS_LONG else with_parser(tmp_path / "toy")
    result = evaluate_once(tmp_path / "data", bundle)
    made = result["generated"]
    assert made["clips"] == made["group"] >= 2 and made["clips_without_near_twin"] is None and not made["by_pair"]
    for shown in (result["captured"], made["mean"]):
        assert {"r_precision_1", "fid", "mm_dist", "diversity", "jerk"} <= set(shown) and "content" not in shown
        assert all(np.isfinite(value["mean"]) for value in shown.values())
    table = capsys.readouterr().out
    assert f"**test**: {made['clips']} clips, no labels" in table and "| fid |" in table


@pytest.mark.skipif(not IS_LONG, reason="KINEGRAPH_LONG=1 trains on CLIP too")
def test_from_a_published_folder_to_figures_with_clip(tmp_path: Path) -> None:
    assert prepare([*write_set("humanml3d", tmp_path), "--out", str(tmp_path / "data"), "--processes", "1"]) == 0
    assets = tmp_path / "assets"
    clip_text_encoder.main(["--clip", str(write_clip(tmp_path / "clip")), "--out", str(assets)])
    for file in ("parser.bin", "arguments.npz"):
        shutil.copy(ASSETS / file, assets)
    train(tmp_path, assets, TWENTY_STEPS.replace("[denoiser]\n", "[denoiser]\ntext_width = 40\n"))
    assert evaluate_once(tmp_path / "data", export(tmp_path, assets))["generated"]["clips"] >= 2


def test_data_without_a_test_split_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = [*write_set("amass", tmp_path), "--test", "0"]
    assert prepare([*folder, "--out", str(tmp_path / "data"), "--processes", "1"]) == 0
    bundle = with_parser(tmp_path / "toy")
    words = ["--data", tmp_path / "data", "--bundle", bundle, "--out", tmp_path / "figures.json"]
    monkeypatch.setattr(sys, "argv", ["evaluate", *map(str, words)])
    assert evaluate.main() == 2
    assert "0 clips in its split test" in capsys.readouterr().err
