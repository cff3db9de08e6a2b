"""Whether training on motion that the model composed itself helps (EnergyMoGen, section 5.5; Table 1, last row).

    python -m kinegraph_benchmarks.ablations.compml --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --start runs/recovered \
        --work compml --count 300 --steps 400 --seeds 1 2 3 --out compml.json

Three rows: the weights of --start as they are, and trained on with recorded motion alone and with recorded and composed
motion, everything else equal: steps, batch, seeds, learning rate. Composed clips come from --bundle, which should have
the weights of --start (`python -m kinegraph_export.recover` makes such a run of a bundle). Rows are sampled in torch
and measured by `evaluate.py`. What is composed, trained and measured is kept in --work: a stopped comparison goes on
where it was.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.bundle.contract import LEVELS
from kinegraph_benchmarks.ablations.compare import evaluate_run, share, table, train
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_training.config import read_preset

AUTOENCODERS = [f"vae_{level}" for level in LEVELS]
BEFORE, RECORDED, COMPOSED = "before", "recorded", "recorded + composed"
RATE = 0.5
"""Of the preset's learning rate, as in the paper (appendix A: 1e-4, then 5e-5 with CompML)."""
WARMUP = 0.1
"""Of all steps: the optimiser starts anew."""

Results = dict[str, list[dict[str, Any]]]


def preset(base: str, seed: int, steps: int) -> str:
    """TOML of a fine-tune; both rows use the same one."""
    rate = RATE * read_preset(base).denoiser_training.learning_rate
    lines = ("[denoiser_training]", f"steps = {steps}", f"learning_rate = {rate}", f"warmup = {int(WARMUP * steps)}")
    return "\n".join((f'base = "{base}"', f"seed = {seed}", "", *lines, ""))


def composed_motion(options: argparse.Namespace) -> Path:
    """The folder of composed clips; made, completed, or there already."""
    folder: Path = options.work / "composed"
    command = [sys.executable, "-m", "kinegraph_training.compml", "--data", str(options.data)]
    command += ["--held-out", str(options.held_out), "--count", str(options.count), "--out", str(folder)]
    command += ["--bundle", str(options.bundle)] if options.bundle else []
    subprocess.run(command, check=True)
    return folder


def fine_tuned(seed: int, more: Sequence[Path], options: argparse.Namespace) -> dict[str, Any]:
    """Train one row's weights on and measure them."""
    name = f"composed_{options.count}" if more else "recorded"
    runs = [options.work / f"{name}_steps{options.steps}_seed{each}" for each in (seed, options.seeds[0])]
    share(runs[0], options.start, AUTOENCODERS)
    if seed != options.seeds[0]:
        share(runs[0], runs[1], ["captions.npz", "latents.pt"])
    (runs[0] / "preset.toml").write_text(preset(options.preset, seed, options.steps), encoding="utf-8")
    start = ["--start-from", str(options.start / "denoisers" / "last.ckpt")]
    train(runs[0], options, [*start, *(word for folder in more for word in ("--more", str(folder)))])
    return evaluate_run(runs[0], options, ["--held-out", str(options.held_out)])


def before(options: argparse.Namespace) -> dict[str, Any]:
    """Measure the weights that both rows start from."""
    run: Path = options.work / "before"
    share(run, options.start, [*AUTOENCODERS, "denoisers", "tables.npz"])
    return evaluate_run(run, options, ["--held-out", str(options.held_out)])


def two_actions_table(results: Results) -> str:
    """Markdown: the share of captions of two actions whose motion shows both, in order and at once, and of those pairs
    that training never joined."""
    first = next(iter(results.values()))[0]["two_actions"]
    places = [(kind, apart) for kind, parts in first.items() for apart in (None, *parts["generated_apart"])]
    names = [" ".join((kind, apart or "all")).replace("_", " ") for kind, apart in places]
    lines = ["**both actions happen**", "", "| | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
    rows = {"captured": [{"two_actions": {kind: as_generated(parts) for kind, parts in first.items()}}], **results}
    for name, found in rows.items():
        values = [[both_hold(one["two_actions"][kind], apart) for one in found] for kind, apart in places]
        lines.append(f"| {name} | " + " | ".join(f"{np.mean(each):.3f}" for each in values) + " |")
    return "\n".join(lines) + "\n"


def as_generated(parts: Mapping[str, Any]) -> dict[str, Any]:
    """The captured motion in the place of the generated."""
    return {"generated": parts["captured"], "generated_apart": parts["captured_apart"]}


def both_hold(parts: Mapping[str, Any], apart: str | None) -> float:
    """Of all captions, or of one group of pairs."""
    found = parts["generated"]["both_hold"]["mean"] if apart is None else parts["generated_apart"][apart]["both_hold"]
    return float(found)


def main() -> int:
    """Compose, train, measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--held-out", type=Path, required=True, help="held_out_pairs.json")
    parser.add_argument("--start", type=Path, required=True, help="run with autoencoders, denoisers and tables.npz")
    parser.add_argument("--bundle", type=Path, help="bundle that composes; the default bundle without it")
    parser.add_argument("--preset", default="edge", help="preset of --start")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--count", type=int, default=300, help="composed clips")
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    options = parser.parse_args()
    composed = composed_motion(options)
    results: Results = {BEFORE: [before(options)], RECORDED: [], COMPOSED: []}
    for seed in options.seeds:
        results[RECORDED].append(fine_tuned(seed, [], options))
        results[COMPOSED].append(fine_tuned(seed, [composed], options))
    text = table(results) + "\n" + two_actions_table(results)
    budget = {name: getattr(options, name) for name in ("count", "steps", "seeds", "repeats")}
    write_report(options.out, {**budget, "rows": results}, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
