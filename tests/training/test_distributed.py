"""Several processes train together (`--devices 2 --strategy ddp`, as the README says): autoencoder and denoisers."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from kinegraph_training.vae_batches import FrameBudgetSampler
from support.toy_run import ASSETS, steps_of

TOGETHER = ("--accelerator", "cpu", "--devices", "2", "--strategy", "ddp", "--enable_progress_bar", "0")


def train_with_two_processes(module: str, folder: Path, *words: str) -> str:
    """Train a stage with two processes; returns what they print."""
    arguments = ("--data", folder / "data", "--run", folder / "run", "--preset", "tiny", "--threads", "1")
    command = [sys.executable, "-m", f"kinegraph_training.{module}", *map(str, arguments), *words, *TOGETHER]
    paths = os.pathsep.join(part for part in sys.path if part)
    result = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env=os.environ | {"PYTHONPATH": paths}, check=False
    )
    assert result.returncode == 0, result.stderr[-2000:]
    return result.stdout + result.stderr


@pytest.mark.skipif(not torch.distributed.is_available(), reason="this torch cannot train in several processes")
@pytest.mark.slow
def test_two_processes_train_an_autoencoder_and_denoisers(trained: Path, tmp_path: Path) -> None:
    (tmp_path / "data").symlink_to(trained / "data")
    for name in ("vae_motion", "vae_action"):
        shutil.copytree(trained / "run" / name, tmp_path / "run" / name)
    output = train_with_two_processes("train_vae", tmp_path, "--level", "specific")
    train_with_two_processes("train_denoisers", tmp_path, "--assets", str(ASSETS))
    assert "MEMBER: 2/2" in output, "two processes there were"
    for stage in ("vae_specific", "denoisers"):
        checkpoint = tmp_path / "run" / stage / "last.ckpt"
        assert steps_of(checkpoint) == 6
        weights = torch.load(checkpoint, weights_only=True)["state_dict"].values()
        assert all(torch.isfinite(value).all() for value in weights)


def test_shares_are_equal_and_have_no_clip_twice() -> None:
    sampler = FrameBudgetSampler([40 + number % 30 for number in range(101)], 300, seed=3)
    whole = {number for batch in sampler for number in batch}
    shares = [sampler.share(rank, 3) for rank in range(3)]
    assert len({len(share) for share in shares}) == 1
    numbers = [number for share in shares for batch in share for number in batch]
    assert len(set(numbers)) == len(numbers)
    assert whole == set(range(101)) and len(numbers) > 80
    assert len(sampler) == len(list(sampler))
