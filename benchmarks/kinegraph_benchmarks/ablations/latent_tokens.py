"""Measure how many latent tokens the specific level needs (EnergyMoGen, Table 8), each number trained alike.

    python -m kinegraph_benchmarks.ablations.latent_tokens --data DATA/bandai \
        --held-out DATA/held_out_pairs.json --autoencoders runs/edge --work comparisons \
        --tokens 2 4 8 16 --out latent_tokens.json

For each number an autoencoder is trained from nothing and scored on captured motion, then one denoiser on the whole
graph, without coarser levels so that only the number differs, and evaluated by `quality.evaluate`. Budgets are short:
the scores rank the numbers, they are not those of the default bundle. Trained weights and scores are kept in --work.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from kinegraph_benchmarks.ablations.training_runs import CAPTION_CACHES, evaluate_run, link_shared, train
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.autoencoder_scores import score_autoencoder
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.label_classifier import LabelClassifier
from kinegraph_benchmarks.common.report_io import write_json, write_report
from kinegraph_benchmarks.common.sample_cache import long_enough
from kinegraph_training.data.clips import read_split
from kinegraph_training.latents import read_vae

SPLITS = ("dev_test", "dev_compositional")
RECONSTRUCTION_METRICS = ("local_mm", "global_mm", "content", "style")
GENERATION_METRICS = ("r_precision_1", "fid", "behaviour", "content", "style", "foot_skate", "jerk")


def preset_toml(tokens: int, options: argparse.Namespace) -> str:
    """Write a TOML preset: the edge preset with another number of tokens, one level, and the budgets of `options`."""
    return (
        f'base = "edge"\nseed = {options.seed}\n\n[vae.specific]\ntokens = {tokens}\n\n'
        f"[vae_training.specific]\nsteps = {options.vae_steps}\n\n"
        f'[denoiser]\nlevels = ["specific"]\n\n[denoiser_training]\nsteps = {options.steps}\n'
    )


def train_vae(run: Path, options: argparse.Namespace) -> None:
    """Train the specific autoencoder of a run, continue, or do nothing if all steps are done."""
    finished = run / "vae_trained"
    if finished.is_file() and finished.read_text() == str(options.vae_steps):
        return
    command = [sys.executable, "-m", "kinegraph_training.train_vae", "--level", "specific"]
    command += ["--data", str(options.data), "--held-out", str(options.held_out)]
    command += ["--run", str(run), "--preset", str(run / "preset.toml")]
    subprocess.run(command, check=True)
    finished.write_text(str(options.vae_steps))


def evaluate_autoencoder(run: Path, data: Path) -> dict[str, dict[str, float]]:
    """Score the autoencoder of a run on each split, or read the scores that are kept in its folder."""
    out = run / "reconstruction.json"
    if not out.is_file():
        vae = read_vae(run / "vae_specific" / "last.ckpt")
        judges = Evaluator(), LabelClassifier(read_split(data, "train"))
        clips = {split: long_enough(read_split(data, split)) for split in SPLITS}
        out.write_text(json.dumps({split: score_autoencoder(vae, clips[split], *judges) for split in SPLITS}))
    scores: dict[str, dict[str, float]] = json.loads(out.read_text(encoding="utf-8"))
    return scores


def measure_tokens(tokens: int, options: argparse.Namespace) -> dict[str, Any]:
    """Train and measure one number of tokens."""
    run: Path = options.work / f"tokens_{tokens}_seed{options.seed}"
    link_shared(run, options.autoencoders, ["vae_motion", "vae_action", *CAPTION_CACHES])
    (run / "preset.toml").write_text(preset_toml(tokens, options), encoding="utf-8")
    train_vae(run, options)
    train(run, options)
    return {"reconstruction": evaluate_autoencoder(run, options.data), "generated": evaluate_run(run, options)}


def markdown_table(results: dict[int, dict[str, Any]]) -> str:
    """Format results as Markdown: scores of the autoencoder, then of generated clips, one line per number of tokens."""
    lines = []
    for split in SPLITS:
        names = [f"kept: {name}" for name in RECONSTRUCTION_METRICS] + list(GENERATION_METRICS)
        lines += [f"**{split}**", "", "| tokens | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
        for tokens, result in results.items():
            generated = result["generated"]["splits"][split]["generated"]["mean"]
            values = [result["reconstruction"][split][name] for name in RECONSTRUCTION_METRICS]
            values += [generated[name]["mean"] for name in GENERATION_METRICS]
            lines.append(f"| {tokens} | " + " | ".join(f"{value:.3g}" for value in values) + " |")
        lines.append("")
    return "\n".join(lines)


def main() -> int:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "held_out", "autoencoders", "out", repeats=3)
    parser.add_argument("--work", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--tokens", type=int, nargs="+", default=[2, 4, 8, 16])
    parser.add_argument("--vae-steps", type=int, default=2000, help="training steps of each autoencoder (2000)")
    parser.add_argument("--steps", type=int, default=1500, help="training steps of each denoiser (1500)")
    parser.add_argument("--seed", type=int, default=1, help="of the training")
    options = parser.parse_args()
    results: dict[int, dict[str, Any]] = {}
    for tokens in options.tokens:
        results[tokens] = measure_tokens(tokens, options)
        budget = {name: getattr(options, name) for name in ("vae_steps", "steps", "repeats", "seed")}
        write_json(options.out, {**budget, "tokens": results})
    write_report(options.out, {**budget, "tokens": results}, markdown_table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
