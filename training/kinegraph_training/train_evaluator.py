"""Train the evaluator: encoders of captions and of motions into one joint space, on captured clips only.

    python -m kinegraph_training.train_evaluator --data DATA/bandai --run runs/evaluator --assets assets

    ... --leave-out     some takes of actions that have none in other splits (`data.left_out`) are not trained on

The same command resumes a stopped run. Further flags are those of `lightning.Trainer`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, WeightedRandomSampler

from kinegraph.motion.features import features_from_joints, normalisation
from kinegraph_training.checkpoints import fit
from kinegraph_training.config import DataConfig, OptimiserConfig
from kinegraph_training.data.caption_cache import CaptionStates, encode_states
from kinegraph_training.data.clips import MotionClip, mirrored_clip, read_jsonl, read_split
from kinegraph_training.data.left_out import left_out_clips
from kinegraph_training.dataset import Dataset, cut_long_clips, validation_set
from kinegraph_training.metrics import label_groups, r_precision
from kinegraph_training.models.evaluator import EvaluatorConfig, MotionEncoder, TextEncoder, contrastive_loss
from kinegraph_training.trainer import configure_optimiser, lightning_flags, make_trainer
from kinegraph_training.vae_batches import pad_clips

DATA = DataConfig()
"""Limits of the lengths of clips."""
TRAINING = OptimiserConfig(steps=1500, learning_rate=5e-4, warmup=100, batch=128, ema=0.998)
TEMPERATURE = 0.1
SEED = 11
BATCHES_PER_EPOCH = 100
VALIDATION_GROUPS = 20
"""Random divisions into groups of 32 that R-precision is averaged over."""

Batch = tuple[Tensor, Tensor, Tensor, Tensor, list[str]]
"""Features and mask of motions, hidden states and mask of captions, labels."""


def clip_label(clip: MotionClip) -> str:
    """Return the label of a clip: clips of one label are not negatives of one another.

    It is made of action and style; without them, of the first caption.
    """
    return f"{clip.action}/{clip.style}" if clip.actions else clip.captions[0]


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
        """Embeddings of motions and captions, and labels, of each batch of validation."""

    def forward(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Encode motions and captions to unit vectors (b, e) each."""
        features, frame_mask, states, piece_mask, _ = batch
        return self.encoders["motion"](features, frame_mask), self.encoders["text"](states, piece_mask)

    def training_step(self, batch: Batch, index: int) -> Tensor:
        motion, text = self(batch)
        labels = np.array(batch[-1])
        same = torch.from_numpy(labels[:, None] == labels[None, :]).to(self.device)
        loss = contrastive_loss(motion.float(), text.float(), same, TEMPERATURE)
        self.log("train/loss", loss, prog_bar=True, batch_size=len(labels))
        return loss

    def validation_step(self, batch: Batch, index: int) -> None:
        motion, text = (embedding.float().cpu().numpy() for embedding in self(batch))
        self.validation.append((motion, text, batch[-1]))

    def on_validation_epoch_end(self) -> None:
        motion, text = (np.concatenate([batch[side] for batch in self.validation]) for side in (0, 1))
        labels = [label for batch in self.validation for label in batch[2]]
        self.validation.clear()
        rng = np.random.default_rng(0)
        hits = [
            r_precision(text[rows], motion[rows])
            for _ in range(VALIDATION_GROUPS)
            for rows in label_groups(labels, 32, rng)
        ]
        for k, value in enumerate(np.mean(hits, axis=0), start=1):
            self.log(f"val/top_{k}", float(value), prog_bar=k == 1)

    def configure_optimizers(self) -> Any:
        return configure_optimiser(self.encoders, self.training_config, str(self.trainer.precision))


def make_collate(dataset: Dataset, states: CaptionStates, seed: int | None) -> Callable[[list[int]], Batch]:
    """Make the function that turns clip indices into a batch.

    Args:
        dataset: clips with features.
        states: of all captions.
        seed: of the caption drawn for each clip; None takes the first caption.
    """
    rng = None if seed is None else np.random.Generator(np.random.PCG64(seed))
    group = EvaluatorConfig().frames_per_token

    def collate(indices: list[int]) -> Batch:
        clips = [dataset.clips[index] for index in indices]
        captions = [clip.captions[0 if rng is None else int(rng.integers(len(clip.captions)))] for clip in clips]
        motions = pad_clips([dataset.features[index] for index in indices], group)
        texts = pad_clips([states.hidden_states(caption) for caption in captions], 1)
        return (*motions, *texts, [clip_label(clip) for clip in clips])

    return collate


def load_clips(data: Path, leave_out: bool = False) -> tuple[Dataset, Dataset]:
    """Load the captured clips of training, with their mirror images, and those of validation.

    The evaluator must not learn from synthetic clips.

    Args:
        data: data folder.
        leave_out: do not train on the clips that `left_out_clips` chooses.
    """
    left_out = left_out_clips(read_jsonl(data / "index.jsonl")) if leave_out else {}
    kept = (clip for clip in read_split(data, "train") if clip.id not in left_out)
    clips = [clip for clip in kept if len(clip.joints) >= DATA.min_frames]
    clips += [mirrored_clip(clip) for clip in clips]
    features = [features_from_joints(clip.joints) for clip in clips]
    mean, std = normalisation(features)
    train = Dataset(clips, [(rows - mean) / std for rows in features], mean, std)
    return cut_long_clips(train, DATA.max_frames), validation_set(data, "val", DATA, mean, std)


def make_loaders(
    train: Dataset, val: Dataset, states: CaptionStates, config: OptimiserConfig
) -> tuple[DataLoader, DataLoader]:
    """Make batches of training and validation; a clip's weight is 1 / sqrt(clips of its label)."""
    labels = [clip_label(clip) for clip in train.clips]
    counts = {label: labels.count(label) for label in set(labels)}
    sampler = WeightedRandomSampler([counts[label] ** -0.5 for label in labels], BATCHES_PER_EPOCH * config.batch)
    collate = make_collate(train, states, SEED)
    train_indices: Any = range(len(train.clips))
    val_indices: Any = range(len(val.clips))
    return (
        DataLoader(train_indices, config.batch, sampler=sampler, collate_fn=collate, drop_last=True),
        DataLoader(val_indices, 64, collate_fn=make_collate(val, states, None)),
    )


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_training.train_evaluator", description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with train.npz, captions.jsonl, index.jsonl")
    parser.add_argument("--run", type=Path, required=True, help="folder for checkpoint and curves")
    parser.add_argument("--assets", type=Path, required=True, help="folder with the text files (a bundle will do)")
    parser.add_argument("--threads", type=int, help="threads torch may use")
    parser.add_argument("--leave-out", action="store_true", help="leave out takes of actions that have none elsewhere")
    parser.add_argument("--steps", type=int, help=f"training steps ({TRAINING.steps})")
    arguments, lightning = parser.parse_known_args(argv)
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    L.seed_everything(SEED)
    training = replace(TRAINING, steps=arguments.steps or TRAINING.steps)
    train, val = load_clips(arguments.data, arguments.leave_out)
    captions = [caption for clip in train.clips + val.clips for caption in clip.captions]
    states = encode_states(captions, arguments.assets, arguments.run / "states.npz")
    train_batches, val_batches = make_loaders(train, val, states, training)
    module = EvaluatorModule(EvaluatorConfig(), training, train.mean.tolist(), train.std.tolist())
    every = min(250, training.steps)
    trainer = make_trainer(arguments.run, training, validate_every=every, lightning=lightning_flags(lightning))
    fit(trainer, module, train_batches, val_batches, arguments.run)


if __name__ == "__main__":
    main()
