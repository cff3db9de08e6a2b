"""Measure whether a negated action is gone and the rest of the sentence stays, in eight forms of negation.

    python -m kinegraph_benchmarks.quality.negations --data DATA/bandai --out negations.json

Each sentence is generated as a user would: "a person walks forward without waving the right hand". The action must be
gone, and the rest must hold as often as in the sentence that ends before the negation. So that gone means something,
the same action is also asked for; and the predicates are checked on captured windows. Writes JSON, and a Markdown table
beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.window_actions import ACTIONS, RUNNING, STRAIGHT_DEGREES, UP_SECONDS, middle_window
from kinegraph_benchmarks.quality.behaviour import SPLITS
from kinegraph_training.data.clips import MotionClip, read_split

GONE: Final = 0.9
"""Goal: share of clips without the negated action."""
KEPT: Final = 0.9
"""Goal: rate of the rest, of its rate in the sentence without the negation."""


@dataclass(frozen=True)
class Negated:
    """An action that sentences negate, in the forms of its words, and how it is recognised beside another one."""

    gerund: str
    bare: str
    third: str
    noun: str | None
    down: str | None
    """"keeping ... down", where there is such a phrase."""
    labels: tuple[str, ...]
    """Labels of captured clips that show it."""
    happens: p.Predicate


def hand_up(*sides: str) -> p.Predicate:
    """Make a predicate: any of these hands is beside its shoulder or higher for `UP_SECONDS`, waving or not."""
    return lambda joints: any(
        len(path) >= UP_SECONDS * p.FPS for side in sides for path in p.raised_hand_paths(joints, side)
    )


def turns_at_all(joints: FloatArray) -> bool:
    """Tell whether the body ends turned by more than `STRAIGHT_DEGREES` to either side."""
    return abs(p.net_turn(joints)) > STRAIGHT_DEGREES


def _labels(*actions: str) -> tuple[str, ...]:
    return tuple(ACTIONS[action].label for action in actions)


NEGATED: Final[Mapping[str, Negated]] = {
    "wave right": Negated(
        "waving the right hand", "wave the right hand", "waves the right hand", "waving of the right hand",
        "keeping the right hand down", _labels("wave right", "wave both"), hand_up("right"),
    ),
    "wave both": Negated(
        "waving the hands", "wave the hands", "waves the hands", "waving", "keeping the hands down",
        _labels("wave left", "wave right", "wave both"), hand_up("left", "right"),
    ),
    "raise both": Negated(
        "raising both hands", "raise both hands", "raises both hands", "raised hands", "keeping both hands down",
        _labels("raise-up left", "raise-up right", "raise-up both"), hand_up("left", "right"),
    ),
    "turn": Negated(
        "turning left", "turn left", "turns left", "turn to the left", None, _labels("turn left", "turn right"),
        turns_at_all,
    ),
    "bow": Negated("bowing", "bow", "bows", "bow", None, _labels("bow"), ACTIONS["bow"].holds),
    "run": Negated("running", "run", "runs", "running", None, _labels("run"), p.faster(RUNNING)),
    "walk": Negated(
        "walking", "walk", "walks", "walking", None, _labels("walk", "turn left", "turn right", "run"),
        lambda joints: not p.stands(joints),
    ),
}  # fmt: skip
"""Actions by name."""

PAIRS: Final = (
    ("walk", "wave right"), ("walk", "raise both"), ("walk", "turn"), ("walk", "bow"), ("walk", "run"),
    ("run", "wave both"), ("run", "turn"), ("bow", "wave right"), ("wave right", "walk"), ("raise-up left", "walk"),
)  # fmt: skip
"""What happens, a key of `ACTIONS`, and what must not, a key of `NEGATED`."""

FORMS: Final[Mapping[str, str]] = {
    "without ...ing": "{host} without {gerund}",
    "does not": "{host} but does not {bare}",
    "not ...ing": "{host}, not {gerund}",
    "never": "{host} and never {third}",
    "no ...": "{host} with no {noun}",
    "keeping ... down": "{host} {down}",
    "stop ...ing": "{host} and stops {gerund}",
    "instead of": "{host} instead of {gerund}",
}
"""Sentences by form of negation; a form that an action has no words for is left out."""


def host_holds(host: str, negated: str) -> p.Predicate:
    """Return the predicate of what must stay: that of the action, or of travelling ahead where that is enough."""
    if host == "walk":
        return p.goes(1, 1, 0.5)
    return p.all_of(p.goes(1, 1, 0.5), p.faster(RUNNING)) if (host, negated) == ("run", "turn") else ACTIONS[host].holds


def sentence_of(form: str, host: str, negated: str) -> str | None:
    """Write the sentence of a form, None where the action has no words for it."""
    words = {"host": ACTIONS[host].sentence, **vars(NEGATED[negated])}
    missing = [name for name in ("noun", "down") if words[name] is None and f"{{{name}}}" in FORMS[form]]
    return None if missing else FORMS[form].format(**words)


def last_half(form: str, joints: FloatArray) -> FloatArray:
    """Return the frames in which the action must be gone: the second half where it stops, else all."""
    return joints[len(joints) // 2 :] if form == "stop ...ing" else joints


def measure_pair(pipe: MotionPipeline, host: str, negated: str, seeds: int) -> list[dict[str, Any]]:
    """Measure one pair in every form: how often the action is gone and the rest is there, one row a sentence."""
    action, seconds, holds = NEGATED[negated], ACTIONS[host].seconds, host_holds(host, negated)

    def generate(text: str) -> list[FloatArray]:
        return [pipe.generate(text, seconds=seconds, seed=seed).joints for seed in range(seeds)]

    plain = float(np.mean([holds(joints) for joints in generate(ACTIONS[host].sentence)]))
    affirmed = float(np.mean([action.happens(x) for x in generate(f"{ACTIONS[host].sentence} while {action.gerund}")]))
    rows = []
    for form in FORMS:
        sentence = sentence_of(form, host, negated)
        if sentence is not None:
            clips = generate(sentence)
            rows.append(
                {
                    "form": form,
                    "host": host,
                    "negated": negated,
                    "sentence": sentence,
                    "gone": float(np.mean([not action.happens(last_half(form, joints)) for joints in clips])),
                    "rest": float(np.mean([holds(joints) for joints in clips])),
                    "rest_without_negation": plain,
                    "happens_if_asked": affirmed,
                }
            )
    return rows


def summarise(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Average rows by form, by negated action and together, and compare with the goals."""

    def mean(chosen: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        numbers = {key: float(np.mean([row[key] for row in chosen])) for key in ("gone", "rest", "happens_if_asked")}
        plain = float(np.mean([row["rest_without_negation"] for row in chosen]))
        kept = numbers["rest"] / plain if plain else None
        met = numbers["gone"] >= GONE and kept is not None and kept >= KEPT
        return {"sentences": len(chosen), **numbers, "kept": kept, "met": met}

    return {
        "by_form": {form: mean(chosen) for form in FORMS if (chosen := [row for row in rows if row["form"] == form])},
        "by_action": {
            name: mean(chosen) for name in NEGATED if (chosen := [row for row in rows if row["negated"] == name])
        },
        "all": mean(rows),
    }


def check_captured(clips: Sequence[MotionClip], style: str | None = "normal") -> dict[str, dict[str, float]]:
    """Check the predicates of `NEGATED` on captured windows of the lengths of `ACTIONS`.

    Returns:
        For each name the share of windows of its labels that meet it (`met`), and of the other labels (`wrong`); hands
        are up in raises and waves alike, so that these are not compared with one another.
    """
    shown = {action.label: action.seconds for action in ACTIONS.values()}
    chosen = [clip for clip in clips if clip.action in shown and style in (None, clip.style)]
    report = {}
    for name, action in NEGATED.items():
        of_hands = any("hand" in label for label in action.labels)
        held: dict[bool, list[bool]] = {True: [], False: []}
        for clip in chosen:
            own = clip.action in action.labels
            if own or not (of_hands and "hand" in clip.action):
                held[own].append(action.happens(middle_window(clip.joints, shown[clip.action])))
        report[name] = {"met": float(np.mean(held[True])), "wrong": float(np.mean(held[False]))}
    return report


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown: forms, actions, and the sentences that miss a goal."""
    total = result["summary"]
    lines = [f"{result['bundle']}, {result['seeds']} seeds a sentence", ""]
    head = "sentences | action gone | rest, of the sentence without negation | action happens if asked | met |"
    for title, rows in (("form", total["by_form"]), ("negated action", total["by_action"])):
        lines += [f"| {title} | {head}", "|---" * 6 + "|"]
        everything = {"**all**": total["all"]} if title == "form" else {}
        for name, row in {**rows, **everything}.items():
            kept = "-" if row["kept"] is None else f"{row['kept']:.3f}"
            cells = f"{row['sentences']} | {row['gone']:.3f} | {kept} | {row['happens_if_asked']:.3f}"
            lines.append(f"| {name} | {cells} | {'yes' if row['met'] else 'no'} |")
        lines.append("")
    lines += [f"Goals: gone in {GONE}, the rest in {KEPT} of the sentence without negation.", ""]
    lines += ["| predicate | captured windows of the action | of others |", "|---|---|---|"]
    lines += [f"| {name} | {row['met']:.2f} | {row['wrong']:.3f} |" for name, row in result["captured_windows"].items()]
    missed = [row for row in result["rows"] if row["gone"] < GONE or row["rest"] < KEPT * row["rest_without_negation"]]
    lines += ["", f"{len(missed)} of {len(result['rows'])} sentences miss a goal:", ""]
    lines += [f"- {row['sentence']}: gone {row['gone']:.1f}, rest {row['rest']:.1f}" for row in missed]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "bundle", "out", seeds=10)
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle, threads=1)
    clips = [clip for split in SPLITS for clip in read_split(options.data, split)]
    rows = [row for host, negated in PAIRS for row in measure_pair(pipe, host, negated, options.seeds)]
    result = {
        "bundle": f"{pipe.manifest.name} {pipe.manifest.version}",
        "seeds": options.seeds,
        "captured_windows": check_captured(clips),
        "summary": summarise(rows),
        "rows": rows,
    }
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
