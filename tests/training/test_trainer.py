"""Checkpoints of a run: the last step is always saved, and a resumed run equals one that was never stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
L = pytest.importorskip("lightning")

from kinegraph_training.checkpoints import fit
from kinegraph_training.config import OptimiserConfig
from kinegraph_training.trainer import configure_optimiser, make_trainer

CONFIG = OptimiserConfig(steps=8, learning_rate=0.1, warmup=2, batch=1, ema=0.9)
QUIET: dict[str, Any] = {"accelerator": "cpu", "precision": "32-true", "enable_progress_bar": False}


class Line(L.LightningModule):  # type: ignore[misc]
    """Model of one weight, which is trained towards 3."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(1))

    def training_step(self, batch: Any, index: int) -> Any:
        return (self.weight - 3.0).square().sum()

    def validation_step(self, batch: Any, index: int) -> None:
        self.log("val/loss", (self.weight - 3.0).square().sum())

    def configure_optimizers(self) -> Any:
        return configure_optimiser(self, CONFIG, "32-true")


def train(run: Path, **flags: Any) -> dict[str, Any]:
    """Start or resume the run, with checkpoints every 3 steps and epochs of 4; returns `last.ckpt`."""
    batches = torch.utils.data.DataLoader(range(4))
    trainer = make_trainer(run, CONFIG, validate_every=3, lightning=QUIET | flags)
    fit(trainer, Line(), batches, batches, run)
    checkpoint: dict[str, Any] = torch.load(run / "last.ckpt", weights_only=True)
    return checkpoint


def weights(checkpoint: dict[str, Any]) -> tuple[float, float]:
    """Return the averaged weight and the live one."""
    return checkpoint["state_dict"]["weight"].item(), checkpoint["current_model_state"]["weight"].item()


@pytest.mark.parametrize(
    ("flags", "steps"),
    [({}, 8), ({"max_steps": 2}, 2), ({"max_steps": 6}, 6), ({"max_steps": -1, "max_epochs": 1}, 4)],
    ids=["between two saves", "before the first", "at one", "after an epoch"],
)
def test_the_last_step_is_kept_whatever_it_is(tmp_path: Path, flags: dict[str, Any], steps: int) -> None:
    checkpoint = train(tmp_path, **flags)
    assert checkpoint["global_step"] == steps
    averaged, live = weights(checkpoint)
    assert 0 < averaged < live, "a run goes on from live weights, not from their average"
    assert [path.name for path in tmp_path.glob("*.ckpt")] == ["last.ckpt"]


@pytest.mark.parametrize("stop", [2, 4, 5, 6])
def test_a_run_that_goes_on_is_the_run_that_never_stopped(tmp_path: Path, stop: int) -> None:
    whole = train(tmp_path / "whole")
    train(tmp_path / "stopped", max_steps=stop)
    further = train(tmp_path / "stopped")
    assert further["global_step"] == 8
    assert weights(further) == weights(whole)
    assert further["lr_schedulers"] == whole["lr_schedulers"]


def test_a_run_that_goes_on_draws_what_it_has_not_drawn(tmp_path: Path) -> None:
    drawn: list[float] = []

    class Collate:
        offset = 0

        def reseed(self, offset: int) -> None:
            self.offset = offset

        def __call__(self, items: list[int]) -> Any:
            return torch.tensor(items)

    class Drawing(Line):
        def training_step(self, batch: Any, index: int) -> Any:
            drawn.append(torch.rand(1).item())
            return super().training_step(batch, index)

    def start(**flags: Any) -> Collate:
        L.seed_everything(7)
        collate = Collate()
        batches = torch.utils.data.DataLoader(range(4), collate_fn=collate)
        trainer = make_trainer(tmp_path, CONFIG, validate_every=4, lightning=QUIET | flags)
        fit(trainer, Drawing(), batches, batches, tmp_path)
        return collate

    assert start(max_steps=4).offset == 0 and start().offset == 4000
    assert len(drawn) == 8 and len(set(drawn)) == 8


def test_a_run_that_is_done_is_left_as_it_is(tmp_path: Path) -> None:
    done = train(tmp_path)
    assert weights(train(tmp_path)) == weights(done)


def test_a_trial_writes_nothing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="last"):
        train(tmp_path, fast_dev_run=5)


def test_a_checkpoint_from_elsewhere_is_replaced_too(tmp_path: Path) -> None:
    train(tmp_path / "there", max_steps=3)
    (tmp_path / "here").mkdir()
    (tmp_path / "there" / "last.ckpt").rename(tmp_path / "here" / "last.ckpt")
    assert train(tmp_path / "here")["global_step"] == 8
