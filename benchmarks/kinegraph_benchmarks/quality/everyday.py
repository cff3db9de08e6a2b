"""Measure how often everyday prompts come out right, over seeds, for one bundle or several side by side.

    python -m kinegraph_benchmarks.quality.everyday --out everyday.json

    ... --bundles A B               folders or names of bundles; the default bundle without it
    ... --prompts FILE FILE         JSON lines of {"text", "seconds", "rules"}; data/paraphrases.jsonl without it
    ... --spaces latent frames      in skeleton space as well, of a bundle that has it
    ... --judge RULES.py            judge by the table RULES of this file as well, on the same clips

A clip is right if it meets all rules of its prompt (`common.everyday_rules`). `quality.everyday_rules` says how
captured clips meet them. Writes JSON with the rate of every prompt, and a Markdown table beside it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.options import LATENT, SPACES
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.everyday_rules import find_rule, meets
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.quality.everyday_rules import read_judge

PARAPHRASES: Final = Path(__file__).parents[2] / "data" / "paraphrases.jsonl"


@dataclass(frozen=True)
class Prompt:
    """One sentence, its length, and what its clips must do."""

    text: str
    seconds: float
    rules: tuple[str, ...]


def read_prompts(path: Path) -> list[Prompt]:
    """Read prompts from JSON lines.

    Raises:
        InvalidInputError: a line lacks something, or names a rule that there is not.
    """
    prompts = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            row = json.loads(line)
            prompt = Prompt(str(row["text"]), float(row["seconds"]), tuple(row["rules"]))
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidInputError(f'{path}, line {number}: must be {{"text", "seconds", "rules"}}') from error
        for rule in prompt.rules:
            find_rule(rule)
        prompts.append(prompt)
    return prompts


def generate_all(pipe: MotionPipeline, prompt: Prompt, seeds: int, **options: Any) -> list[FloatArray]:
    """Generate the clips of a prompt, one a seed; `options` are keywords of `generate`."""
    return [pipe.generate(prompt.text, seconds=prompt.seconds, seed=seed, **options).joints for seed in range(seeds)]


def measure_prompts(
    pipe: MotionPipeline,
    prompts: Sequence[Prompt],
    seeds: int,
    judge: Mapping[str, p.Predicate] | None = None,
    **options: Any,
) -> list[dict[str, Any]]:
    """Measure the rate of every prompt.

    Args:
        pipe: the bundle.
        prompts: what is asked for.
        seeds: number of clips of each.
        judge: predicates of another judge by name of the rule; a prompt with a rule that it lacks gets no rate from it.
        options: keywords of `generate`.

    Returns:
        One row a prompt: text, rules, `rate` and `judge`, the rate by the other judge or None.
    """
    rows = []
    for prompt in prompts:
        clips = generate_all(pipe, prompt, seeds, **options)
        other = None
        if judge is not None and all(rule in judge for rule in prompt.rules):
            other = float(np.mean([all(judge[rule](clip.astype(float)) for rule in prompt.rules) for clip in clips]))
        rate = float(np.mean([meets(clip, prompt.rules) for clip in clips]))
        rows.append({"text": prompt.text, "rules": list(prompt.rules), "rate": rate, "judge": other})
    return rows


def summarise(rows: Sequence[Mapping[str, Any]], key: str = "rate") -> dict[str, Any] | None:
    """Compute mean rate, number of prompts, and how many are at zero; None where no row has a rate of that key."""
    rates = [row[key] for row in rows if row[key] is not None]
    if not rates:
        return None
    return {"mean": float(np.mean(rates)), "prompts": len(rates), "at_zero": sum(rate == 0 for rate in rates)}


def rates_by_rule(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Compute the mean rate of the prompts that ask for each rule, and their number."""
    by_rule: dict[str, list[float]] = {}
    for row in rows:
        for rule in row["rules"]:
            by_rule.setdefault(rule, []).append(row["rate"])
    return {rule: {"prompts": len(rates), "mean": float(np.mean(rates))} for rule, rates in sorted(by_rule.items())}


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown: for each file the means, then one line for each prompt with a column a bundle."""
    bundles = result["bundles"]
    lines = [f"{', '.join(bundles)}; {result['seeds']} seeds a prompt", ""]
    for file, runs in result["files"].items():
        lines += [f"**{file}**", "", "| bundle | mean | at zero | prompts | other judge: mean | at zero |"]
        lines.append("|---" * 6 + "|")
        for bundle in bundles:
            own, other = (summarise(runs[bundle], key) for key in ("rate", "judge"))
            cells = [f"{own['mean']:.3f}", own["at_zero"], own["prompts"]] if own else ["-"] * 3
            cells += [f"{other['mean']:.3f}", other["at_zero"]] if other else ["-"] * 2
            lines.append(f"| {bundle} | " + " | ".join(map(str, cells)) + " |")
        lines += ["", "| prompt | rules | " + " | ".join(bundles) + " |", "|---" * (2 + len(bundles)) + "|"]
        for rows in zip(*(runs[bundle] for bundle in bundles), strict=True):
            cells = [rows[0]["text"], " + ".join(rows[0]["rules"]), *(f"{row['rate']:.2f}" for row in rows)]
            lines.append("| " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "out", seeds=10)
    parser.add_argument(
        "--bundles", nargs="+", default=[None], help="folders or names of bundles; the default bundle without it"
    )
    parser.add_argument("--spaces", nargs="+", choices=SPACES, default=[LATENT], help="frames: skeleton space, too")
    parser.add_argument("--prompts", type=Path, nargs="+", default=[PARAPHRASES], help="files of prompts")
    parser.add_argument("--judge", type=Path, help="Python file with another table RULES; it is run")
    parser.add_argument("--threads", type=int, default=1, help="threads of a model (1)")
    options = parser.parse_args()
    judge = read_judge(options.judge) if options.judge else None
    prompts = {path.name: read_prompts(path) for path in options.prompts}
    result: dict[str, Any] = {"seeds": options.seeds, "bundles": [], "files": {name: {} for name in prompts}}
    # All before the first is measured: a bundle that cannot be read is told at once.
    for pipe in [MotionPipeline.load(bundle, threads=options.threads) for bundle in options.bundles]:
        plain = bundle_name(pipe, result["bundles"])
        for space in options.spaces:
            name = plain if space == LATENT else f"{plain}, {space}"
            result["bundles"].append(name)
            for file, asked in prompts.items():
                result["files"][file][name] = measure_prompts(pipe, asked, options.seeds, judge, space=space)
    result["summary"] = {
        file: {
            name: {
                "rate": summarise(rows),
                "judge": summarise(rows, "judge"),
                "zero": [row["text"] for row in rows if row["rate"] == 0],
                "by_rule": rates_by_rule(rows),
            }
            for name, rows in runs.items()
        }
        for file, runs in result["files"].items()
    }
    write_report(options.out, result, markdown_table(result))


def bundle_name(pipe: MotionPipeline, taken: Sequence[str]) -> str:
    """Name a bundle by its manifest, with a number where another one of the run has the same name."""
    name = f"{pipe.manifest.name} {pipe.manifest.version}"
    same = sum(other.split(" (")[0] == name for other in taken)
    return f"{name} ({same + 1})" if same else name


if __name__ == "__main__":
    main()
