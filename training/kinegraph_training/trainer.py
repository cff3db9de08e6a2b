"""Everything that the training commands share: optimiser, weight averaging, checkpoints, learning curves, arguments."""

from __future__ import annotations

import argparse
import csv
import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import ModelCheckpoint, WeightAveraging
from lightning.pytorch.loggers import CSVLogger
from torch import nn

from kinegraph.errors import InvalidInputError
from kinegraph_training.checkpoints import read_checkpoint
from kinegraph_training.config import OptimiserConfig

TOKEN_PARAMETERS = frozenset(("query", "latent_position", "position", "coarse_position"))
"""Last name of the parameters (tokens, width) that hold one row per latent token."""
NEW_LAYERS = (".mixing.", ".seams.")
KIND_EMBEDDING = ".kind.weight"
"""Parts of the denoisers' parameter names that older checkpoints lack, or have fewer rows of."""
FINAL_RATE = 0.02
"""Learning rate at the end of a run, as a share of its peak."""


class RampedEma(WeightAveraging):
    """Exponential moving average of the weights whose decay at update n is min(decay, (1 + n) / (10 + n)).

    The ramp keeps a short run from being stuck at its initial weights. Validation and checkpoints use the averaged
    weights; the live ones are stored beside them for resuming.
    """

    def __init__(self, decay: float) -> None:
        def lerp(averaged: list[torch.Tensor], live: list[torch.Tensor], count: torch.Tensor | int) -> None:
            n = int(count)
            torch._foreach_lerp_(averaged, live, 1.0 - min(decay, (1 + n) / (10 + n)))

        super().__init__(use_buffers=False, multi_avg_fn=lerp)


def configure_optimiser(module: nn.Module, config: OptimiserConfig, precision: str) -> dict[str, Any]:
    """Build AdamW with linear warm-up and cosine decay to `FINAL_RATE`, for Lightning's `configure_optimizers`.

    The rate depends on the step count alone, so that a resumed run follows the same curve. In float32 the fused
    optimiser saves an eighth of a denoiser step on a CPU; under mixed precision Lightning refuses to clip gradients
    for it.

    Args:
        module: its parameters that require gradients are trained.
        config: of the stage.
        precision: the trainer's, such as "32-true".
    """
    adam = torch.optim.AdamW(
        [p for p in module.parameters() if p.requires_grad],
        lr=config.learning_rate,
        betas=(0.9, config.beta2),
        weight_decay=config.weight_decay,
        fused=precision == "32-true",
    )

    def rate(step: int) -> float:
        if step < config.warmup:
            return (step + 1) / config.warmup
        progress = min(1.0, (step - config.warmup) / max(1, config.steps - config.warmup))
        return FINAL_RATE + (1 - FINAL_RATE) * 0.5 * (1 + math.cos(math.pi * progress))

    schedule = torch.optim.lr_scheduler.LambdaLR(adam, rate)
    return {"optimizer": adam, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


class LastCheckpoint(ModelCheckpoint):
    """Writes `last.ckpt` every so many steps and when the run ends, for whatever reason."""

    def __init__(self, folder: Path, every: int) -> None:
        # Resuming from a checkpoint that was copied here must replace it too: no last-v1.ckpt beside it.
        super().__init__(folder, save_last=True, save_top_k=0, every_n_train_steps=every, enable_version_counter=False)

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        super().on_train_epoch_end(trainer, pl_module)
        if trainer.fit_loop.done and not trainer.fast_dev_run:
            trainer.save_checkpoint(Path(self.dirpath) / f"{self.CHECKPOINT_NAME_LAST}{self.FILE_EXTENSION}")

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Do not save here: EMA weights have replaced the live weights, and resuming needs the live ones."""


class SeedPerProcess(L.Callback):
    """Gives each process of distributed training, and each start of a run, a random seed of its own.

    Initial weights are equal. A run that goes on would else draw again what it drew at its beginning.
    """

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        offset = trainer.global_rank + 1000 * trainer.global_step
        if not offset:
            return
        torch.manual_seed(torch.initial_seed() + offset)
        reseed = getattr(getattr(trainer.train_dataloader, "collate_fn", None), "reseed", None)
        if reseed is not None:
            reseed(offset)


class LearningCurves(L.Callback):
    """Merges the logs of all starts of a run into metrics.csv and plots them as curves.png, after each validation."""

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if trainer.sanity_checking or not trainer.is_global_zero or not isinstance(trainer.logger, CSVLogger):
            return
        trainer.logger.save()
        folder = Path(trainer.logger.root_dir)
        rows = merge_logs(sorted(folder.glob("start_*/metrics.csv")))
        write_table(folder / "metrics.csv", rows)
        draw_curves(folder / "curves.png", rows)


Row = dict[str, str]


def merge_logs(tables: list[Path]) -> list[Row]:
    """Merge the logs of a resumed run; where steps overlap, the later log wins."""
    merged: list[Row] = []
    for table in tables:
        with table.open(newline="") as file:
            rows = list(csv.DictReader(file))
        if rows:
            first_step = int(rows[0]["step"])
            merged = [row for row in merged if int(row["step"]) < first_step] + rows
    return merged


def write_table(path: Path, rows: list[Row]) -> None:
    """Write rows as CSV, with a column for every metric that any row has."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names, restval="")
        writer.writeheader()
        writer.writerows(rows)


def draw_curves(path: Path, rows: list[Row]) -> None:
    """Plot every metric over steps, one panel each, as a PNG file."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    series: dict[str, list[tuple[int, float]]] = defaultdict(list)
    for row in rows:
        for name, value in row.items():
            if name not in ("step", "epoch") and value:
                series[name].append((int(row["step"]), float(value)))
    names = sorted(series)
    if not names:
        return
    lines = -(-len(names) // 4)
    figure, axes = pyplot.subplots(lines, 4, figsize=(16, 3 * lines), squeeze=False)
    for axis, name in zip(axes.flat, names, strict=False):
        axis.plot(*zip(*series[name], strict=True), linewidth=1)
        axis.set_title(name, fontsize=9)
        if min(value for _, value in series[name]) > 0:
            axis.set_yscale("log")
    for axis in axes.flat[len(names) :]:
        axis.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=70)
    pyplot.close(figure)


def fast_precision() -> str:
    """Choose mixed bfloat16 where the hardware multiplies it, else float32.

    On a CPU without AVX-512, bfloat16 is 13 times slower than float32.
    """
    has_bfloat16 = torch.cuda.is_available() or "AVX512" in torch.backends.cpu.get_cpu_capability()
    return "bf16-mixed" if has_bfloat16 else "32-true"


def make_trainer(
    run: Path,
    config: OptimiserConfig,
    *,
    validate_every: int,
    lightning: dict[str, Any],
    callbacks: Sequence[L.Callback] = (),
) -> L.Trainer:
    """Build a Lightning trainer that writes checkpoints and learning curves into `run`.

    Args:
        run: folder of the stage.
        config: of the stage.
        validate_every: steps between validations, and between checkpoints.
        lightning: further arguments of `lightning.Trainer` (devices, strategy ...), before those set here.
        callbacks: of the stage, beside those of every stage.
    """
    # Lightning empties the folder of a log it opens, so each start gets its own.
    starts = len(list((run / "curves").glob("start_*")))
    logger = CSVLogger(run, name="curves", version=f"start_{starts:03d}")
    options: dict[str, Any] = {
        "accelerator": "auto",
        "precision": fast_precision(),
        "max_steps": config.steps,
        "gradient_clip_val": config.clip,
        "val_check_interval": validate_every,
        "check_val_every_n_epoch": None,
        "log_every_n_steps": 50,
        "num_sanity_val_steps": 0,
        "enable_model_summary": False,
        # FrameBudgetSampler divides batches among processes itself; random samplers need no division.
        "use_distributed_sampler": False,
        "callbacks": [
            *(LastCheckpoint(run, validate_every), RampedEma(config.ema), SeedPerProcess(), LearningCurves()),
            *callbacks,
        ],
        "logger": logger,
    }
    return L.Trainer(**(options | lightning))


def load_start_weights(module: nn.Module, checkpoint: Path, prefix: str) -> None:
    """Load the weights that another run's checkpoint holds under names beginning with `prefix`.

    A module whose latent has a multiple of the checkpoint's tokens starts with each token repeated: token k stands for
    the k-th part of a clip, so the two halves of that part start from the token of the whole. Layers among context
    tokens, convolutions over seams and kinds of tokens that the checkpoint does not know start as a new module has
    them: the layers change nothing at first.

    Args:
        module: receives the weights.
        checkpoint: of another run, of the same shape but for the number of latent tokens.
        prefix: of the names in the checkpoint; removed.

    Raises:
        InvalidInputError: no such file, or weights of another shape.
    """
    if not checkpoint.is_file():
        raise InvalidInputError(f"--start-from {checkpoint}: there is no such file")
    weights = read_checkpoint(checkpoint)["state_dict"]
    state = {name.removeprefix(prefix): value for name, value in weights.items() if name.startswith(prefix)}
    for name, value in module.state_dict().items():
        if name.split(".")[-1] in TOKEN_PARAMETERS and name in state:
            state[name] = repeat_rows(state[name], len(value))
        elif any(part in name for part in NEW_LAYERS):
            state.setdefault(name, value)
        elif name.endswith(KIND_EMBEDDING) and name in state:
            state[name] = torch.cat([state[name], value[len(state[name]) :]])
    try:
        module.load_state_dict(state)
    except RuntimeError as error:
        raise InvalidInputError(f"--start-from {checkpoint}: not this preset's network: {error}") from error


def repeat_rows(rows: torch.Tensor, count: int) -> torch.Tensor:
    """Repeat each row of (n, d) count / n times to (count, d); return them unchanged if n does not divide count."""
    return rows if count % len(rows) else rows.repeat_interleave(count // len(rows), dim=0)


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments that autoencoders and denoisers share."""
    parser.add_argument("--data", type=Path, required=True, help="folder with train.npz, captions.jsonl, index.jsonl")
    parser.add_argument("--held-out", type=Path, help="JSON of action pairs that must not be composed in training")
    parser.add_argument(
        "--more",
        type=Path,
        action="append",
        default=[],
        help="another data folder, trained on as it is; may be repeated",
    )
    parser.add_argument("--run", type=Path, required=True, help="folder for checkpoints and curves")
    parser.add_argument("--preset", default="edge", help="edge, paper, tiny, or a TOML file")
    parser.add_argument("--threads", type=int, help="threads torch may use")
    parser.add_argument(
        "--start-from", type=Path, help="checkpoint of the same shape whose weights a new run starts with"
    )


def lightning_flags(words: list[str]) -> dict[str, Any]:
    """Parse words such as `--devices 2 --strategy ddp` into keyword arguments of lightning.Trainer."""
    if len(words) % 2 or any(not name.startswith("--") for name in words[::2]):
        raise SystemExit(f"unknown arguments {' '.join(words)}; flags of lightning.Trainer come as --name value")
    flags: dict[str, Any] = {}
    for name, value in zip(words[::2], words[1::2], strict=True):
        key = name.removeprefix("--").replace("-", "_")
        flags[key] = int(value) if value.lstrip("-").isdigit() else value
    return flags
