"""What every stage shares: optimiser, averaged weights, checkpoints, curves."""

from __future__ import annotations

import argparse
import csv
import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import ModelCheckpoint, WeightAveraging
from lightning.pytorch.loggers import CSVLogger
from torch import nn

from kinegraph.errors import InvalidInputError
from kinegraph_training.config import OptimiserConfig

PER_TOKEN = frozenset(("query", "latent_position", "position"))
"""Parameters (tokens, width) of autoencoders and denoisers that belong to the tokens of their own latent."""


class RampedEma(WeightAveraging):
    """Exponential moving average whose decay grows as (1 + n) / (10 + n), so that a short run is not stuck at its
    start. Validation and checkpoints use the averaged weights; the live ones are kept for resuming."""

    def __init__(self, decay: float) -> None:
        def lerp(averaged: list[torch.Tensor], live: list[torch.Tensor], count: torch.Tensor | int) -> None:
            n = int(count)
            torch._foreach_lerp_(averaged, live, 1.0 - min(decay, (1 + n) / (10 + n)))

        super().__init__(use_buffers=False, multi_avg_fn=lerp)


def optimiser(module: nn.Module, config: OptimiserConfig, precision: str) -> dict[str, Any]:
    """AdamW, linear warm-up, cosine to 2 % by step count (so that a resumed run follows the same curve).

    `precision` is the trainer's: in float32 the step is one pass over all weights, which spares an eighth of a denoiser
    step on a CPU; under mixed precision Lightning refuses to clip gradients for such a step.
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
        part = min(1.0, (step - config.warmup) / max(1, config.steps - config.warmup))
        return 0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * part))

    schedule = torch.optim.lr_scheduler.LambdaLR(adam, rate)
    return {"optimizer": adam, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


class LastCheckpoint(ModelCheckpoint):
    """`last.ckpt`, every so many steps and after the last one, whatever ended the run."""

    def __init__(self, folder: Path, every: int) -> None:
        # Resuming from a checkpoint that was copied here must replace it too: no last-v1.ckpt beside it.
        super().__init__(folder, save_last=True, save_top_k=0, every_n_train_steps=every, enable_version_counter=False)

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        super().on_train_epoch_end(trainer, pl_module)
        if trainer.fit_loop.done and not trainer.fast_dev_run:
            trainer.save_checkpoint(Path(self.dirpath) / f"{self.CHECKPOINT_NAME_LAST}{self.FILE_EXTENSION}")

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Too late to save: the average has taken the place of the live weights, from which a run goes on."""


class SeedPerProcess(L.Callback):
    """Processes that train together begin with the same weights, then draw samples and noise of their own."""

    def setup(self, trainer: L.Trainer, pl_module: L.LightningModule, stage: str) -> None:
        if trainer.global_rank:
            torch.manual_seed(torch.initial_seed() + trainer.global_rank)


class Curves(L.Callback):
    """Joins the tables of all starts of a run into metrics.csv and draws it as curves.png, after each validation."""

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
    """Rows of one run that was started several times: what a later start did again replaces what was there."""
    rows: list[Row] = []
    for table in tables:
        with table.open(newline="") as file:
            own = list(csv.DictReader(file))
        if own:
            first = int(own[0]["step"])
            rows = [row for row in rows if int(row["step"]) < first] + own
    return rows


def write_table(path: Path, rows: list[Row]) -> None:
    """A CSV with a column for every metric that any row has."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names, restval="")
        writer.writeheader()
        writer.writerows(rows)


def draw_curves(path: Path, rows: list[Row]) -> None:
    """One panel per metric over steps."""
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
    """Mixed bfloat16 where the hardware multiplies it; on a CPU without AVX-512 it is 13 times slower than float32."""
    fast = torch.cuda.is_available() or "AVX512" in torch.backends.cpu.get_cpu_capability()
    return "bf16-mixed" if fast else "32-true"


def trainer(run: Path, config: OptimiserConfig, *, validate_every: int, lightning: dict[str, Any]) -> L.Trainer:
    """A Lightning trainer that resumes from `run/last.ckpt`; `lightning` are its own flags (devices, strategy ...)."""
    # Lightning empties the folder of a table it opens, so each start gets its own
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
        # FrameBudgetSampler hands out shares itself, and who draws at random needs none
        "use_distributed_sampler": False,
        "callbacks": [LastCheckpoint(run, validate_every), RampedEma(config.ema), SeedPerProcess(), Curves()],
        "logger": logger,
    }
    return L.Trainer(**(options | lightning))


def start_weights(module: nn.Module, checkpoint: Path, prefix: str) -> None:
    """Give a module the weights that another run's checkpoint holds under names that begin with `prefix`.

    A latent of twice (three times ...) the tokens begins with each of them repeated: token k stands for the k-th part
    of a clip, so its two halves begin as what it was.

    Raises:
        InvalidInputError: no such file, or weights of another shape.
    """
    if not checkpoint.is_file():
        raise InvalidInputError(f"--start-from {checkpoint}: there is no such file")
    weights = torch.load(checkpoint, map_location="cpu", weights_only=True)["state_dict"]
    own = {name.removeprefix(prefix): value for name, value in weights.items() if name.startswith(prefix)}
    wanted = {name: len(value) for name, value in module.state_dict().items() if name.split(".")[-1] in PER_TOKEN}
    own.update({name: repeated(own[name], tokens) for name, tokens in wanted.items() if name in own})
    try:
        module.load_state_dict(own)
    except RuntimeError as error:
        raise InvalidInputError(f"--start-from {checkpoint}: not this preset's network: {error}") from error


def repeated(rows: torch.Tensor, count: int) -> torch.Tensor:
    """(n, d) -> (count, d), each row as often as `count` holds n; unchanged where it does not."""
    return rows if count % len(rows) else rows.repeat_interleave(count // len(rows), dim=0)


def last_checkpoint(run: Path) -> str | None:
    """Where to resume, if the run was started before."""
    path = run / "last.ckpt"
    return str(path) if path.is_file() else None


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of every stage."""
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
    """`--devices 2 --strategy ddp` as keyword arguments of lightning.Trainer."""
    if len(words) % 2 or any(not name.startswith("--") for name in words[::2]):
        raise SystemExit(f"unknown arguments {' '.join(words)}; flags of lightning.Trainer come as --name value")
    flags: dict[str, Any] = {}
    for name, value in zip(words[::2], words[1::2], strict=True):
        key = name.removeprefix("--").replace("-", "_")
        flags[key] = int(value) if value.lstrip("-").isdigit() else value
    return flags
