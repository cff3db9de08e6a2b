"""Check the rules of everyday actions on captured clips: met by clips of their labels, and by others.

    python -m kinegraph_benchmarks.quality.everyday_rules --data DATA/bandai DATA/open --out everyday_rules.json

    ... --judge RULES.py            another judge with a table RULES: how often both agree, on the same clips

A rule is useful where clips that show its action meet it (right) and clips that do not show it fail (wrong). Labels
that may go either way are in neither. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import runpy
from collections.abc import Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph.errors import InvalidInputError
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.everyday_rules import RULES, find_rule
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.sample_cache import long_enough
from kinegraph_training.data.clips import MotionClip, read_split

SPLITS: Final = ("train", "val", "dev_test")

STANDING: Final = ("stand-still", "stand-idle")
GESTURES: Final = ("raise-up-*", "wave-*", "you-gesture-*", "no-gesture-*", "stop-gesture-*", "point-*", "guide")
GAITS: Final = ("walk", "walk-turn-left", "walk-turn-right", "walk-and-stop", "start-walking")
RUNS: Final = ("run", "dash", "jog")
KICKS: Final = ("kick-*", "kick")
PUNCHES: Final = ("punch-*", "jab-*", "hook-*", "straight-*", "one-two")
JUMPS: Final = ("jump-up", "jump-in-place", "jump-forward", "jump-forward-left", "jump-left", "broad-jump")
FALLS: Final = ("fall-down", "fall-down-and-get-up")
CALM: Final = (*STANDING, *GESTURES)

CHECKS: Final[Mapping[str, tuple[Sequence[str], Sequence[str]]]] = {
    "forward": ((*GAITS, *RUNS, "jump-forward"), (*CALM, "walk-backward*", "walk-back", "walk-sideways-*")),
    "backward": (("walk-backward*", "walk-back"), (*CALM, *GAITS, *RUNS)),
    "leftward": (("walk-sideways-left", "run-sideways-left"), (*CALM, *GAITS, *RUNS, "walk-back", "*-sideways-right")),
    "rightward": (("walk-sideways-right", "run-sideways-right"), (*CALM, *GAITS, *RUNS, "walk-back")),
    "stays": (CALM, ("walk", "run", "dash")),
    "still": (("stand-still",), (*GAITS, *RUNS, "raise-up-*", "wave-*", *PUNCHES)),
    "turn_left": (("walk-turn-left", "turn-left*"), (*CALM, "walk", *RUNS, "walk-turn-right", "walk-circle-*")),
    "turn_right": (("walk-turn-right", "turn-right*"), (*CALM, "walk", *RUNS, "walk-turn-left", "walk-circle-*")),
    "no_turn": (("walk", *RUNS, *CALM), ("walk-turn-left", "walk-turn-right", "walk-circle-*", "walk-u-turn-*")),
    "around": (("walk-u-turn-*", "full-turn-*", "turn-around-*"), (*CALM, "walk", *RUNS)),
    "circle": (("walk-circle-*",), ("walk", "walk-turn-left", "walk-turn-right", "walk-u-turn-*", "turn-*", *CALM)),
    "stops": (("walk-and-stop",), ("walk", *RUNS, "start-walking", *CALM)),
    "fast": (("run", "dash"), (*CALM, "walk", "walk-turn-left", "walk-turn-right")),
    "slow": (("walk-and-stop", *CALM), RUNS),
    "jumps": (JUMPS, (*CALM, *GAITS, *PUNCHES, *FALLS, "duck-punches")),
    "crouches": (("duck-punches", "crouch*", "reach-floor-*"), (*CALM, *GAITS, "run", "bow")),
    "down": (FALLS, (*CALM, *GAITS, *RUNS, *KICKS, *PUNCHES, *JUMPS, "duck-punches")),
    "gets_up": (("get-up", "fall-down-and-get-up"), (*CALM, *GAITS, *RUNS, "fall-down", "lie-down")),
    "sits": (
        ("sit-ankle-on-knee", "throw-away-right"),
        (*CALM, *GAITS, *RUNS, *FALLS, "get-up", "crouch*", "pick-up-*"),
    ),
    "bows": (("bow",), (*STANDING, "raise-up-*", "wave-*", *JUMPS)),
    "kicks": (KICKS, (*CALM, *GAITS, *RUNS, *PUNCHES, *JUMPS, *FALLS)),
    "kicks_left": (("kick-*-left",), ("kick-*right", *CALM, *GAITS, *RUNS)),
    "kicks_right": (("kick-*right",), ("kick-*-left", *CALM, *GAITS, *RUNS)),
    "punches": (PUNCHES, (*CALM, "walk", "run", "bow", "duck-punches", "block-punches", "catch-right", "reach-*")),
    "punches_left": (("jab-left", "hook-left"), ("punch-right", "jab-right", "hook-right", *CALM)),
    "punches_right": (("punch-right", "jab-right", "hook-right"), ("jab-left", "hook-left", *CALM)),
    "reaches_down": (("pick-up-*", "reach-floor-*"), (*CALM, *GAITS, *RUNS, "reach-up-*")),
    "picks_up": (("pick-up-*", "reach-floor-*"), (*CALM, *GAITS, *RUNS, "fall-down", "lie-down")),
    "reaches_up": (("reach-up-*", "raise-up-*", "jump-reach-*"), (*STANDING, *GAITS, "reach-floor-*")),
    "left_up": (("raise-up-left-hand",), ("raise-up-right-hand", "raise-up-both-hands", *STANDING, *GAITS)),
    "right_up": (("raise-up-right-hand",), ("raise-up-left-hand", "raise-up-both-hands", *STANDING, *GAITS)),
    "both_up": (("raise-up-both-hands",), ("raise-up-left-hand", "raise-up-right-hand", *STANDING, *GAITS)),
    "hands_down": (("stand-still", "walk", "walk-turn-left", "walk-turn-right"), ("raise-up-*", "wave-*")),
    "waves_left": (("wave-left-hand",), ("wave-right-hand", "wave-both-hands", "raise-up-*", *GAITS, *STANDING)),
    "waves_right": (("wave-right-hand",), ("wave-left-hand", "wave-both-hands", "raise-up-*", *GAITS, *STANDING)),
    "waves_both": (("wave-both-hands",), ("wave-left-hand", "wave-right-hand", "raise-up-*", *GAITS, *STANDING)),
    "no_wave": (("raise-up-*", *GAITS, *RUNS, *STANDING), ("wave-*",)),
    "forward>stays": (("walk-and-stop",), ("walk", *RUNS, "start-walking", *CALM)),
    "down>gets_up": (("fall-down-and-get-up",), ("fall-down", "get-up", *CALM, *GAITS)),
}
"""Rule -> patterns of labels whose clips meet it, and of labels whose clips do not."""


def has_label(clip: MotionClip, patterns: Sequence[str]) -> bool:
    """Tell whether a clip's action fits one of some patterns ("raise-up-*")."""
    return any(fnmatch(clip.action, pattern) for pattern in patterns)


def check_rule(name: str, clips: Sequence[MotionClip]) -> dict[str, Any]:
    """Check one rule of `CHECKS`: numbers of clips, and shares that meet it, of those that should and those not."""
    holds, row = find_rule(name), {}
    for title, patterns in zip(("right", "wrong"), CHECKS[name], strict=True):
        held = [holds(clip.joints) for clip in clips if has_label(clip, patterns)]
        row |= {f"{title}_clips": len(held), title: float(np.mean(held)) if held else None}
    return row


def agreement(clips: Sequence[MotionClip], other: Mapping[str, p.Predicate]) -> dict[str, float]:
    """Compute, for each rule that both judges have, the share of clips of which they say the same."""
    names = [name for name in RULES if name in other]
    return {
        name: float(np.mean([RULES[name](clip.joints) == bool(other[name](clip.joints)) for clip in clips]))
        for name in names
    }


def read_judge(path: Path) -> Mapping[str, p.Predicate]:
    """Read the table RULES, name -> predicate, of a Python file; the file is run.

    Raises:
        InvalidInputError: it has no such table.
    """
    rules = runpy.run_path(str(path)).get("RULES")
    if not isinstance(rules, dict):
        raise InvalidInputError(f"{path} has no table RULES of predicates by name")
    return rules


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown: one line for each rule."""
    lines = ["| rule | clips that show it | meet it | others | meet it | both judges agree |", "|---" * 6 + "|"]
    for name, row in result["rules"].items():
        cells = [f"{row[title]:.3f}" if row[title] is not None else "-" for title in ("right", "wrong")]
        same = f"{result['agreement'][name]:.3f}" if name in result["agreement"] else "-"
        lines.append(f"| {name} | {row['right_clips']} | {cells[0]} | {row['wrong_clips']} | {cells[1]} | {same} |")
    means = [np.mean([r[t] for r in result["rules"].values() if r[t] is not None]) for t in ("right", "wrong")]
    overall = f", {np.mean(list(result['agreement'].values())):.3f} agreed" if result["agreement"] else ""
    lines += [
        "",
        f"Means over rules: {means[0]:.3f} right, {means[1]:.3f} wrong{overall}; {result['clips']} clips.",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "out")
    parser.add_argument(
        "--data", type=Path, nargs="+", required=True, help="each a folder of the captured motion (bandai)"
    )
    parser.add_argument("--judge", type=Path, help="Python file with another table RULES; it is run")
    options = parser.parse_args()
    clips = long_enough([clip for data in options.data for split in SPLITS for clip in read_split(data, split)])
    result = {
        "clips": len(clips),
        "rules": {name: check_rule(name, clips) for name in CHECKS},
        "agreement": agreement(clips, read_judge(options.judge)) if options.judge else {},
    }
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
