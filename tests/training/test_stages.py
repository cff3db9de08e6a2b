"""The stages of training at the size of a toy: data -> three autoencoders -> denoisers."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")
pytest.importorskip("spacy")

from kinegraph.bundle.contract import LEVELS
from kinegraph.errors import InvalidInputError
from kinegraph_training import train_denoisers, train_vae
from kinegraph_training.data.folder import PreparedClip, write_data
from support.motions import walk
from support.toy_run import ASSETS, run_stage, steps_of, write_walks


@pytest.mark.parametrize("precision", ["32-true", "bf16-mixed"])
def test_a_step_is_taken_whatever_the_hardware_prefers(precision: str, tmp_path: Path) -> None:
    write_walks(tmp_path / "data")
    run_stage(train_vae, tmp_path, "--level", "motion", "--precision", precision, "--max_steps", "1")
    assert steps_of(tmp_path / "run" / "vae_motion" / "last.ckpt") == 1


def test_a_stopped_run_goes_on_to_its_last_step(trained: Path) -> None:
    for name in ("vae_motion", "vae_action", "vae_specific", "denoisers"):
        assert steps_of(trained / "run" / name / "last.ckpt") == 6


def test_curves_are_kept_as_a_table_and_a_picture(trained: Path) -> None:
    for name in ("vae_specific", "denoisers"):
        curves = trained / "run" / name / "curves"
        with (curves / "metrics.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        values = [float(row[key]) for row in rows for key in row if key.startswith("val/") and row[key]]
        assert values and np.isfinite(values).all()
        # what came before the stop is still there
        assert [int(row["step"]) for row in rows] == sorted(int(row["step"]) for row in rows)
        assert name != "denoisers" or {2, 5} <= {int(row["step"]) for row in rows}
        assert name != "denoisers" or "val/swing" in rows[0]
        assert (curves / "curves.png").read_bytes()[:4] == b"\x89PNG"


def test_denoisers_start_from_the_weights_of_others(trained: Path, tmp_path: Path) -> None:
    source = trained / "run" / "denoisers" / "last.ckpt"
    (tmp_path / "data").symlink_to(trained / "data")
    shutil.copytree(trained / "run", tmp_path / "run", ignore=shutil.ignore_patterns("denoisers"))
    still = ["--start-from", str(source), "--max_steps", "1", "--val_check_interval", "1", "--gradient_clip_val", "0"]
    preset = tmp_path / "still.toml"
    preset.write_text('base = "tiny"\n[denoiser_training]\nlearning_rate = 0.0\nsteps = 1\n')
    run_stage(train_denoisers, tmp_path, "--assets", str(ASSETS), *still, "--preset", str(preset))
    before, after = (
        torch.load(path, weights_only=True, map_location="cpu")["state_dict"]
        for path in (source, tmp_path / "run" / "denoisers" / "last.ckpt")
    )
    assert all(torch.equal(before[name], after[name]) for name in before if name.startswith("hierarchy."))


def test_a_graph_encoder_stays_what_it_was(trained: Path, tmp_path: Path) -> None:
    source = trained / "run" / "denoisers" / "last.ckpt"
    (tmp_path / "data").symlink_to(trained / "data")
    shutil.copytree(trained / "run", tmp_path / "run", ignore=shutil.ignore_patterns("denoisers"))
    flags = ["--keep-graph-encoder", "--max_steps", "2", "--val_check_interval", "1"]
    run_stage(train_denoisers, tmp_path, "--assets", str(ASSETS), "--start-from", str(source), *flags)
    before, after = (
        torch.load(path, weights_only=True, map_location="cpu")["state_dict"]
        for path in (source, tmp_path / "run" / "denoisers" / "last.ckpt")
    )
    kept = {name for name in before if name.startswith("hierarchy.graph_encoder.")}
    assert kept and all(torch.equal(before[name], after[name]) for name in kept)
    assert not torch.equal(*(of["hierarchy.levels.specific.step.noise_out.weight"] for of in (before, after)))
    with pytest.raises(InvalidInputError, match="needs --start-from"):
        train_denoisers.main(["--keep-graph-encoder", "--data", "x", "--run", "x", "--assets", "x"])


def test_denoisers_train_on_further_folders(trained: Path, tmp_path: Path) -> None:
    clip = PreparedClip(
        "c", walk(52), ("a person walks and waves the left hand",), "composed", "train", "a+b", "normal"
    )
    write_data(tmp_path / "more", [clip], 20)
    (tmp_path / "data").symlink_to(trained / "data")
    for level in LEVELS:
        shutil.copytree(trained / "run" / f"vae_{level}", tmp_path / "run" / f"vae_{level}")
    more = ["--more", str(tmp_path / "more"), "--max_steps", "1", "--val_check_interval", "1"]
    run_stage(train_denoisers, tmp_path, "--assets", str(ASSETS), *more)
    assert steps_of(tmp_path / "run" / "denoisers" / "last.ckpt") == 1
    with np.load(tmp_path / "run" / "captions.npz", allow_pickle=False) as cache:
        captions = cache["text"].tobytes().decode()  # end to end
    assert all(f"a person walks and waves the {side} hand" in captions for side in ("left", "right"))
