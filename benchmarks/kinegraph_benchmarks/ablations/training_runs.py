"""Train and evaluate the runs of an ablation, each in its own folder, skipping what is done already."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.bundle.reader import text_files_folder
from kinegraph_training.data.caption_cache import cache_files

COLUMNS = ("r_precision_1", "fid", "mm_dist", "behaviour", "content", "style", "claims_degrees", "foot_skate", "jerk")

CAPTION_CACHES = [file.name for name in ("captions.npz", "captions_masked.npz") for file in cache_files(Path(name))]
"""Files of a run that hold its encoded captions."""


def link_shared(run: Path, source: Path, names: Sequence[str]) -> None:
    """Make the folder of a run, and link to the files that it has in common with another run.

    Args:
        run: folder to make.
        source: the other run.
        names: files and folders of `source`; those that are missing there are skipped.
    """
    run.mkdir(parents=True, exist_ok=True)
    for name in names:
        original, link = source.resolve() / name, run / name
        if original.exists() and not link.exists():
            link.symlink_to(original)


def train(
    run: Path,
    options: argparse.Namespace,
    extra_arguments: Sequence[str] = (),
    stage: str = "train_denoisers",
    assets: Path | None = None,
) -> None:
    """Train the denoisers of a run with its preset.toml, continue, or do nothing if all steps are done.

    Args:
        run: folder of the run.
        options: `data`, `held_out` and `steps`.
        extra_arguments: of the command.
        stage: module of `kinegraph_training` whose command trains.
        assets: folder of the text files; None takes those of installed bundles.
    """
    finished = run / "trained"
    if finished.is_file() and finished.read_text() == str(options.steps):
        return
    command = [sys.executable, "-m", f"kinegraph_training.{stage}", "--data", str(options.data)]
    command += ["--held-out", str(options.held_out), "--run", str(run), "--preset", str(run / "preset.toml")]
    command += ["--assets", str(assets or text_files_folder()), *extra_arguments]
    subprocess.run(command, check=True)
    finished.write_text(str(options.steps))


def evaluate_run(run: Path, options: argparse.Namespace, extra_arguments: Sequence[str] = ()) -> dict[str, Any]:
    """Evaluate a run with `quality.evaluate`, or read the evaluation that is kept in its folder."""
    out = run / "evaluation.json"
    if not out.is_file():
        command = [sys.executable, "-m", "kinegraph_benchmarks.quality.evaluate"]
        command += ["--data", str(options.data), "--run", str(run), "--work", str(run / "takes")]
        command += ["--repeats", str(options.repeats), "--out", str(out), *extra_arguments]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    evaluation: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return evaluation


def markdown_table(results: dict[str, list[dict[str, Any]]]) -> str:
    """Format evaluations as Markdown: mean over seeds, with the standard deviation where there are several.

    Args:
        results: evaluations by row, one for each seed.
    """
    lines = []
    for split in next(iter(results.values()))[0]["splits"]:
        lines += [f"**{split}**", "", "| | " + " | ".join(COLUMNS) + " |", "|---|" + "---|" * len(COLUMNS)]
        rows = {"captured": [seed["splits"][split]["captured"] for seed in next(iter(results.values()))[:1]]}
        rows |= {
            name: [seed["splits"][split]["generated"]["mean"] for seed in seeds] for name, seeds in results.items()
        }
        for name, seeds in rows.items():
            cells = []
            for column in COLUMNS:
                values = [metrics[column]["mean"] for metrics in seeds if column in metrics]
                spread = f" ± {np.std(values, ddof=1):.3f}" if len(values) > 1 else ""
                cells.append(f"{np.mean(values):.3f}{spread}" if values else "-")
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)
