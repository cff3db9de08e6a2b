"""How often the networks see which clip."""

from __future__ import annotations

from collections import Counter, defaultdict

import numpy as np
import pytest

pytest.importorskip("torch")
import lightning as L
import torch
from torch.utils.data import DataLoader

from kinegraph_training.config import DataConfig
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.sampling_weights import sampling_weights
from kinegraph_training.vae_batches import FrameBudgetSampler

JOINTS = np.zeros((2, 22, 3), dtype=np.float32)


def clips(counts: dict[tuple[str, str], int]) -> list[MotionClip]:
    return [
        MotionClip(f"{made}{label}{number}", JOINTS, ("x",), (label,), "", made_by=made)
        for (made, label), count in counts.items()
        for number in range(count)
    ]


def shares(pool: list[MotionClip], config: DataConfig) -> tuple[dict[str, float], dict[str, float]]:
    weights = sampling_weights(pool, config)
    assert abs(weights.sum() - 1.0) < 1e-9 and (weights > 0).all()
    kinds: Counter[str] = Counter()
    labels: Counter[str] = Counter()
    for clip, weight in zip(pool, weights, strict=True):
        kinds[clip.made_by] += weight
        labels[clip.action] += weight
    return dict(kinds), dict(labels)


def many(made: str, count: int) -> dict[tuple[str, str], int]:
    return {(made, f"action{number}"): 10 for number in range(count)}


def test_what_made_a_clip_has_its_share() -> None:
    pool = clips({**many("", 40), **many("splices_2", 30), **many("bent", 30)})
    kinds, _ = shares(pool, DataConfig(draws={"splices_2": 0.2, "bent": 0.05}))
    assert kinds == pytest.approx({"": 0.75, "splices_2": 0.2, "bent": 0.05}, abs=1e-6)


def test_rare_actions_come_more_often_and_none_too_often() -> None:
    pool = clips({**many("", 40), ("", "walk"): 1000, ("", "kick-left"): 2})
    _, labels = shares(pool, DataConfig())
    # By the number of clips a walk would have 71 %, a kick 0.14 %.
    assert labels["walk"] == pytest.approx(0.05, abs=2e-3)
    assert labels["kick-left"] > 4 * 2 / len(pool)
    assert labels["action0"] > labels["kick-left"]


def test_an_action_of_many_styles_does_not_come_more_often_for_them() -> None:
    styled = [
        MotionClip(f"bow{number}", JOINTS, ("x",), ("bow",), f"style{number % 5}", made_by="") for number in range(10)
    ]
    config = DataConfig(label_cap=1.0)
    weights = sampling_weights([*clips(many("", 3)), *styled], config)
    assert weights[-10:].sum() == pytest.approx(0.25) and np.ptp(weights[-10:]) < 1e-12
    uneven = [*styled, MotionClip("bow10", JOINTS, ("x",), ("bow",), "rare", made_by="")]
    of_style = sampling_weights(uneven, config)
    assert of_style[-1] / of_style[0] == pytest.approx(2 ** (1 - config.label_power))


def test_autoencoders_draw_clips_as_often_as_their_weights_say() -> None:
    lengths, weights = [40] * 30, np.array([1.0] * 29 + [29.0])
    sampler = FrameBudgetSampler(lengths, 400, seed=1, weights=weights)
    drawn = Counter[int]()
    for epoch in range(40):
        sampler.set_epoch(epoch)
        batches = sampler.batches()
        assert sum(map(len, batches)) == 30 and all(len(batch) <= 10 for batch in batches)
        drawn.update(index for batch in batches for index in batch)
    assert drawn[29] / 1200 == pytest.approx(0.5, abs=0.05) and len(drawn) == 30
    assert sampler.batches() == sampler.batches()
    once = FrameBudgetSampler(lengths, 400, seed=1).batches()
    assert sorted(index for batch in once for index in batch) == list(range(30))


def test_each_epoch_of_a_run_draws_anew() -> None:
    class Model(L.LightningModule):
        def training_step(self, batch: torch.Tensor) -> torch.Tensor:
            drawn[self.current_epoch] += batch.tolist()
            return self.weight.sum()

        def configure_optimizers(self) -> torch.optim.Optimizer:
            return torch.optim.SGD([self.weight], 0.1)

    drawn: defaultdict[int, list[int]] = defaultdict(list)
    model = Model()
    model.weight = torch.nn.Parameter(torch.zeros(1))
    sampler = FrameBudgetSampler([40] * 30, 400, seed=1, weights=np.ones(30))
    trainer = L.Trainer(
        max_epochs=3, logger=False, enable_checkpointing=False, enable_progress_bar=False, use_distributed_sampler=False
    )
    trainer.fit(model, DataLoader(range(30), batch_sampler=sampler))
    assert len(drawn) == 3 and all(len(indices) == 30 for indices in drawn.values())
    assert len({tuple(sorted(indices)) for indices in drawn.values()}) == 3


def test_what_is_wanted_often_comes_as_many_times_as_asked() -> None:
    pool = clips({**many("", 60), ("", "kick-left"): 10})
    _, plain = shares(pool, DataConfig())
    _, often = shares(pool, DataConfig(often=["kick"], often_weight=2.0))
    assert often["kick-left"] / plain["kick-left"] == pytest.approx(2.0, rel=0.05)
