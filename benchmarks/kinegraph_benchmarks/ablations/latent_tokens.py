"""How many latent tokens the specific level needs: EnergyMoGen's Table 8, each number trained alike.

    python -m kinegraph_benchmarks.ablations.latent_tokens --data DATA/bandai \
        --held-out DATA/held_out_pairs.json --autoencoders runs/edge \
        --work comparisons --tokens 2 4 8 16 --out latent_tokens.json

For each number: an autoencoder from nothing, what it keeps of captured motion, and one denoiser on the whole graph
(no coarser levels, so that nothing but the number differs), measured by `evaluate.py`. Short budgets: the numbers rank,
they are not those of the default bundle. What is trained and measured is kept in --work.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from kinegraph_benchmarks.ablations.compare import evaluate_run, share, train
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.label_classifier import Recogniser
from kinegraph_benchmarks.common.report_io import write_json, write_report
from kinegraph_benchmarks.quality.reconstruction import MIN_FRAMES, level_scores
from kinegraph_training.data.clips import read_split
from kinegraph_training.latents import read_vae

SPLITS = ("dev_test", "dev_compositional")
KEPT = ("local_mm", "global_mm", "content", "style")
MADE = ("r_precision_1", "fid", "behaviour", "content", "style", "foot_skate", "jerk")


def preset(tokens: int, options: argparse.Namespace) -> str:
    """TOML: the edge preset with another number of tokens, one level, and these budgets."""
    return (
        f'base = "edge"\nseed = {options.seed}\n\n[vae.specific]\ntokens = {tokens}\n\n'
        f"[vae_training.specific]\nsteps = {options.vae_steps}\n\n"
        f'[denoiser]\nlevels = ["specific"]\n\n[denoiser_training]\nsteps = {options.steps}\n'
    )


def train_vae(run: Path, options: argparse.Namespace) -> None:
    """Train, or go on, or do nothing where all steps are done."""
    done = run / "vae_trained"
    if done.is_file() and done.read_text() == str(options.vae_steps):
        return
    command = [sys.executable, "-m", "kinegraph_training.train_vae", "--level", "specific"]
    command += ["--data", str(options.data), "--held-out", str(options.held_out)]
    command += ["--run", str(run), "--preset", str(run / "preset.toml")]
    subprocess.run(command, check=True)
    done.write_text(str(options.vae_steps))


def reconstructed(run: Path, data: Path) -> dict[str, dict[str, float]]:
    """What the autoencoder of a run keeps, per split; stored beside it."""
    out = run / "reconstruction.json"
    if not out.is_file():
        vae = read_vae(run / "vae_specific" / "last.ckpt")
        judges = Evaluator(), Recogniser(read_split(data, "train"))
        clips = {name: [c for c in read_split(data, name) if len(c.joints) >= MIN_FRAMES] for name in SPLITS}
        out.write_text(json.dumps({name: level_scores(vae, found, *judges) for name, found in clips.items()}))
    found: dict[str, dict[str, float]] = json.loads(out.read_text(encoding="utf-8"))
    return found


def measure(tokens: int, options: argparse.Namespace) -> dict[str, Any]:
    """One number of tokens, trained and measured."""
    run: Path = options.work / f"tokens_{tokens}_seed{options.seed}"
    share(run, options.autoencoders, ["vae_motion", "vae_action", "captions.npz", "captions_masked.npz"])
    (run / "preset.toml").write_text(preset(tokens, options), encoding="utf-8")
    train_vae(run, options)
    train(run, options)
    return {"reconstruction": reconstructed(run, options.data), "generated": evaluate_run(run, options)}


def table(results: dict[int, dict[str, Any]]) -> str:
    """Markdown: the autoencoder's numbers, then the generated ones, one line per number of tokens."""
    lines = []
    for split in SPLITS:
        names = [f"kept: {name}" for name in KEPT] + list(MADE)
        lines += [f"**{split}**", "", "| tokens | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
        for tokens, found in results.items():
            made = found["generated"]["splits"][split]["generated"]["mean"]
            values = [found["reconstruction"][split][name] for name in KEPT] + [made[name]["mean"] for name in MADE]
            lines.append(f"| {tokens} | " + " | ".join(f"{value:.3g}" for value in values) + " |")
        lines.append("")
    return "\n".join(lines)


def main() -> int:
    """Train and measure every number."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--held-out", type=Path, required=True)
    parser.add_argument("--autoencoders", type=Path, required=True, help="run with coarser autoencoders and captions")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--tokens", type=int, nargs="+", default=[2, 4, 8, 16])
    parser.add_argument("--vae-steps", type=int, default=2000)
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    options = parser.parse_args()
    results: dict[int, dict[str, Any]] = {}
    for tokens in options.tokens:
        results[tokens] = measure(tokens, options)
        budget = {name: getattr(options, name) for name in ("vae_steps", "steps", "repeats", "seed")}
        write_json(options.out, {**budget, "tokens": results})
    write_report(options.out, {**budget, "tokens": results}, table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
