"""Train the evaluator: two encoders that bring captions and motions together, on recorded clips only.

    python -m kinegraph_training.train_evaluator --data DATA/bandai --run runs/evaluator --assets assets

Stopped runs go on where they were. Further flags are Lightning's own.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, WeightedRandomSampler

from kinegraph_training.config import DataConfig, OptimiserConfig
from kinegraph_training.data.caption_cache import CaptionStates, caption_states
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.dataset import Dataset, training_set, validation_set
from kinegraph_training.metrics import label_groups, r_precision
from kinegraph_training.models.evaluator import EvaluatorConfig, MotionEncoder, TextEncoder, contrastive_loss
from kinegraph_training.trainer import last_checkpoint, lightning_flags, optimiser, trainer
from kinegraph_training.vae_batches import padded

DATA = DataConfig(splices=0, sequences=0)
"""Recorded clips and their mirror images: what is measured with must not be made up."""
TRAINING = OptimiserConfig(steps=1500, learning_rate=5e-4, warmup=100, batch=128, ema=0.998)
TEMPERATURE = 0.1
SEED = 11

Batch = tuple[Tensor, Tensor, Tensor, Tensor, list[str]]


def label(clip: MotionClip) -> str:
    """Clips of one label are no negatives of one another; without labels, clips of one first caption are not."""
    return f"{clip.content}/{clip.style}" if clip.content else clip.captions[0]


class EvaluatorModule(L.LightningModule):
    """Both encoders, the normalisation of motion, and the loss."""

    def __init__(self, config: EvaluatorConfig, training: OptimiserConfig, mean: list[float], std: list[float]) -> None:
        super().__init__()
        self.save_hyperparameters({"config": vars(config), "training": vars(training)})
        self.encoders = nn.ModuleDict({"motion": MotionEncoder(config), "text": TextEncoder(config)})
        self.training_config = training
        self.register_buffer("mean", torch.tensor(mean))
        self.register_buffer("std", torch.tensor(std))
        self.validation: list[tuple[np.ndarray, np.ndarray, list[str]]] = []

    def forward(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Unit vectors (b, e) of the motions and of the captions."""
        features, frame_mask, states, piece_mask, _ = batch
        return self.encoders["motion"](features, frame_mask), self.encoders["text"](states, piece_mask)

    def training_step(self, batch: Batch, index: int) -> Tensor:
        motion, text = self(batch)
        names = np.array(batch[-1])
        same = torch.from_numpy(names[:, None] == names[None, :]).to(self.device)
        loss = contrastive_loss(motion.float(), text.float(), same, TEMPERATURE)
        self.log("train/loss", loss, prog_bar=True, batch_size=len(names))
        return loss

    def validation_step(self, batch: Batch, index: int) -> None:
        motion, text = (part.float().cpu().numpy() for part in self(batch))
        self.validation.append((motion, text, batch[-1]))

    def on_validation_epoch_end(self) -> None:
        motion, text = (np.concatenate([part[side] for part in self.validation]) for side in (0, 1))
        labels = [name for part in self.validation for name in part[2]]
        self.validation.clear()
        rng = np.random.default_rng(0)
        hits = [r_precision(text[rows], motion[rows]) for _ in range(20) for rows in label_groups(labels, 32, rng)]
        for place, value in enumerate(np.mean(hits, axis=0), start=1):
            self.log(f"val/top_{place}", float(value), prog_bar=place == 1)

    def configure_optimizers(self) -> Any:
        return optimiser(self.encoders, self.training_config, str(self.trainer.precision))


def collate(dataset: Dataset, states: CaptionStates, seed: int | None) -> Any:
    """Clip numbers -> a batch, with a caption drawn for each clip; None takes the first."""
    rng = None if seed is None else np.random.Generator(np.random.PCG64(seed))
    group = EvaluatorConfig().frames_per_token

    def make(numbers: list[int]) -> Batch:
        clips = [dataset.clips[number] for number in numbers]
        chosen = [clip.captions[0 if rng is None else int(rng.integers(len(clip.captions)))] for clip in clips]
        motion = padded([dataset.features[number] for number in numbers], group)
        return (*motion, *padded([states.hidden(caption) for caption in chosen], 1), [label(clip) for clip in clips])

    return make


def within(dataset: Dataset, max_frames: int) -> Dataset:
    """Longer clips are cut: a few hundred frames of dance tell no more than the first ten seconds."""
    return Dataset(dataset.clips, [rows[:max_frames] for rows in dataset.features], dataset.mean, dataset.std)


def loaders(data: Path, assets: Path, run: Path, config: OptimiserConfig) -> tuple[DataLoader, DataLoader, Dataset]:
    """Training and validation batches; rare labels are drawn more often, by the root of their number."""
    train = within(training_set(data, DATA, None), DATA.max_frames)
    val = validation_set(data, "val", DATA, train.mean, train.std)
    captions = [caption for clip in train.clips + val.clips for caption in clip.captions]
    states = caption_states(captions, assets, run / "states.npz")
    names = [label(clip) for clip in train.clips]
    counts = {name: names.count(name) for name in set(names)}
    sampler = WeightedRandomSampler([counts[name] ** -0.5 for name in names], 100 * config.batch)
    numbers: Any = range(len(train.clips))
    val_numbers: Any = range(len(val.clips))
    return (
        DataLoader(numbers, config.batch, sampler=sampler, collate_fn=collate(train, states, SEED), drop_last=True),
        DataLoader(val_numbers, 64, collate_fn=collate(val, states, None)),
        train,
    )


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_training.train_evaluator", description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with train.npz, captions.jsonl, index.jsonl")
    parser.add_argument("--run", type=Path, required=True, help="folder for checkpoint and curves")
    parser.add_argument("--assets", type=Path, required=True, help="folder with the text files (a bundle will do)")
    parser.add_argument("--threads", type=int, help="threads torch may use")
    arguments, lightning = parser.parse_known_args(argv)
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    L.seed_everything(SEED)
    train, val, dataset = loaders(arguments.data, arguments.assets, arguments.run, TRAINING)
    module = EvaluatorModule(EvaluatorConfig(), TRAINING, dataset.mean.tolist(), dataset.std.tolist())
    every = min(250, TRAINING.steps)
    loop = trainer(arguments.run, TRAINING, validate_every=every, lightning=lightning_flags(lightning))
    loop.fit(module, train, val, ckpt_path=last_checkpoint(arguments.run))


if __name__ == "__main__":
    main()
