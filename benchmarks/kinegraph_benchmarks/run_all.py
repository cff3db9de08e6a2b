"""Every table of the model, one command: runs what has not been measured yet and joins the tables into one page.

    python -m kinegraph_benchmarks.run_all --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --run runs/edge --out results

A measurement whose JSON is in --out already is not repeated: remove the file to measure again. Each of them also keeps
its own takes in --work, so a stopped one goes on where it was. The comparisons train models and take hours.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
VARIANTS = ("ours", "one_stage", "concat", "no_graph", "no_reasoning", "specific_only", "motion_specific",
            "nodes_by_level")  # fmt: skip


@dataclass(frozen=True)
class Measurement:
    """One script and what it is told: it writes `{name}.json` and prints its table."""

    name: str
    title: str
    arguments: tuple[str, ...]


def measurements(given: argparse.Namespace) -> list[Measurement]:
    """All of them, the cheap ones first."""
    data, work, out = ("--data", str(given.data)), ("--work", str(given.work)), given.out
    held = ("--held-out", str(given.held_out))
    run, repeats = ("--run", str(given.run)), ("--repeats", str(given.repeats))
    found = [
        Measurement("reconstruction", "What the autoencoders keep (GraphMotion, Table D)", (*data, *run)),
        Measurement("behaviour", "Behaviours beside captured clips", data),
        Measurement("lengths", "Sentences at any length", data),
        Measurement("foot_fix", "Feet held, and not", data),
        Measurement("evaluate", "The default bundle", (*data, *held, *work, *repeats)),
        Measurement("masked_verbs", "Verbs masked (GraphMotion, Table 6)", (*data, *work)),
        Measurement("edit_curves", "Weights of edges", ()),
        Measurement("composition_settings", "Ways of composing (EnergyMoGen, Tables 7 and 9)", (*data, *held)),
        Measurement("sampling", "Steps, spacing and guidance", (*data, *work)),
    ]
    if given.compare_steps:
        seeds = tuple(map(str, given.seeds))
        budget = ("--steps", str(given.compare_steps), "--seeds", *seeds)
        more = ("--autoencoders", str(given.run), "--work", str(given.work / "comparisons"))
        title = f"Comparisons and ablations, {given.compare_steps} steps each, seeds {', '.join(seeds)}"
        found.append(Measurement("compare", title, (*VARIANTS, *data, *held, *more, *budget)))
        tokens = (*data, *held, *more, "--steps", str(given.compare_steps // 2))
        found.append(Measurement("latent_tokens", "Latent tokens (EnergyMoGen, Table 8)", tokens))
    return [Measurement(m.name, m.title, (*m.arguments, "--out", str(out / f"{m.name}.json"))) for m in found]


def page(folder: Path, found: Sequence[Measurement]) -> str:
    """The tables there are, one after another."""
    parts = [
        "# What was measured\n",
        "Made by `python -m kinegraph_benchmarks.run_all`; every number is in the JSON beside it.\n",
    ]
    for one in found:
        table = folder / f"{one.name}.md"
        if table.is_file():
            parts.append(f"## {one.title}\n\n{table.read_text(encoding='utf-8').strip()}\n")
    return "\n".join(parts)


def main() -> int:
    """0: all is measured; else the exit status of the measurement that failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--held-out", type=Path, required=True, help="held_out_pairs.json")
    parser.add_argument("--run", type=Path, required=True, help="training run with the three autoencoders")
    parser.add_argument("--work", type=Path, default=Path("evaluation"), help="folder for generated clips and runs")
    parser.add_argument("--out", type=Path, required=True, help="folder of the tables")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--compare-steps", type=int, default=3000, help="training steps of each variant; 0 for none")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    found = measurements(given)
    for number, one in enumerate(found, start=1):
        if (given.out / f"{one.name}.json").is_file():
            continue
        print(f"{number} of {len(found)}: {one.title}", file=sys.stderr)
        start = time.monotonic()
        command = [sys.executable, str(HERE / f"{one.name}.py"), *one.arguments]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        if not (given.out / f"{one.name}.json").is_file():
            return done.returncode
        (given.out / f"{one.name}.md").write_text(done.stdout, encoding="utf-8")
        # What was measured so far is joined whatever happens next.
        (given.out / "README.md").write_text(page(given.out, found), encoding="utf-8")
        print(f"   {time.monotonic() - start:.0f} s", file=sys.stderr)
    (given.out / "README.md").write_text(page(given.out, found), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
