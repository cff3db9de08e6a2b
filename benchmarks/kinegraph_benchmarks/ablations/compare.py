"""Models at equal data and training budget: train each variant, measure it, and put them in one table.

    python -m kinegraph_benchmarks.ablations.compare --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --autoencoders runs/edge \
        --work comparisons --steps 3000 --seeds 1 2 3 ours one_stage

Variants are the presets in `comparisons/`. All share the autoencoders of one run. What is trained and measured is kept
in --work: a stopped comparison goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.reader import DEFAULT_BUNDLE

HERE = Path(__file__).resolve().parent
COLUMNS = ("r_precision_1", "fid", "mm_dist", "behaviour", "content", "style", "claims_degrees", "foot_skate", "jerk")


def share(run: Path, source: Path, names: Sequence[str]) -> None:
    """Make the folder of a run, and link to what it has in common with another."""
    run.mkdir(parents=True, exist_ok=True)
    for name in names:
        original, link = source.resolve() / name, run / name
        if original.exists() and not link.exists():
            link.symlink_to(original)


def prepare(variant: str, seed: int, options: argparse.Namespace) -> Path:
    """The folder of one run: links to the shared autoencoders and caches, and its preset."""
    run: Path = options.work / f"{variant}_seed{seed}"
    vaes = [f"vae_{level}" for level in LEVELS]
    share(run, options.autoencoders, [*vaes, "captions.npz", "captions_masked.npz", "latents.pt", "states.npz"])
    base = HERE / "comparisons" / f"{variant}.toml"
    text = f'base = "{base}"\nseed = {seed}\n\n[denoiser_training]\nsteps = {options.steps}\n'
    (run / "preset.toml").write_text(text, encoding="utf-8")
    return run


def train(run: Path, options: argparse.Namespace, more: Sequence[str] = ()) -> None:
    """Train, or go on, or do nothing where all steps are done; `more` are further words of the command."""
    done = run / "trained"
    if done.is_file() and done.read_text() == str(options.steps):
        return
    command = [sys.executable, "-m", "kinegraph_training.train_denoisers", "--data", str(options.data)]
    command += ["--held-out", str(options.held_out), "--run", str(run), "--preset", str(run / "preset.toml")]
    command += ["--assets", str(DEFAULT_BUNDLE), *more]
    subprocess.run(command, check=True)
    done.write_text(str(options.steps))


def evaluate_run(run: Path, options: argparse.Namespace, more: Sequence[str] = ()) -> dict[str, Any]:
    """The evaluation of a run, kept beside it; `more` are further words of the command."""
    out = run / "evaluation.json"
    if not out.is_file():
        command = [sys.executable, str(HERE / "evaluate.py"), "--data", str(options.data), "--run", str(run)]
        command += ["--work", str(run / "takes"), "--repeats", str(options.repeats), "--out", str(out), *more]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return found


def table(results: dict[str, list[dict[str, Any]]]) -> str:
    """Markdown: mean over seeds, with the spread where there are several."""
    lines = []
    for split in ("dev_test", "dev_compositional"):
        lines += [f"**{split}**", "", "| | " + " | ".join(COLUMNS) + " |", "|---|" + "---|" * len(COLUMNS)]
        rows = {"captured": [one["splits"][split]["captured"] for one in next(iter(results.values()))[:1]]}
        rows |= {name: [one["splits"][split]["generated"]["mean"] for one in found] for name, found in results.items()}
        for name, found in rows.items():
            cells = []
            for column in COLUMNS:
                values = [one[column]["mean"] for one in found if column in one]
                spread = f" ± {np.std(values, ddof=1):.3f}" if len(values) > 1 else ""
                cells.append(f"{np.mean(values):.3f}{spread}" if values else "-")
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def main() -> int:
    """Train and measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = sorted(path.stem for path in (HERE / "comparisons").glob("*.toml"))
    parser.add_argument("variants", nargs="+", choices=known)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--held-out", type=Path, required=True)
    parser.add_argument("--autoencoders", type=Path, required=True, help="run with the three trained autoencoders")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--out", type=Path, help="write everything as JSON")
    options = parser.parse_args()
    results: dict[str, list[dict[str, Any]]] = {}
    for seed in options.seeds:
        for variant in options.variants:
            run = prepare(variant, seed, options)
            train(run, options)
            results.setdefault(variant, []).append(evaluate_run(run, options))
    text = table(results)
    (options.work / "comparison.md").write_text(text, encoding="utf-8")
    if options.out:
        budget = {"steps": options.steps, "seeds": options.seeds, "repeats": options.repeats}
        options.out.write_text(json.dumps({**budget, "variants": results}, indent=1) + "\n", encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
