"""Measure how far turns go: as the networks make them, as clips have them, and captured ones beside.

    python -m kinegraph_benchmarks.quality.turns --data DATA/studio --out turns.json

    ... --bundles A B      folders or names of bundles; the default bundle without it

Clips turn as far as their sentence says (`kinegraph.text.turns`, `kinegraph.motion.turning`); *as made* is without
that. A turn is the change of heading from the first frame to the last, towards the side that is asked for. *Near* is
the share of clips within 30 % of what is asked for: a quarter turn where a sentence does not say how far, and one
round for a circle. Writes JSON with every turn, and a Markdown table beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import LEVELS
from kinegraph.clip import Clip
from kinegraph.decoding import MotionDecoder
from kinegraph.motion.turning import turned_to
from kinegraph.options import GenerateOptions
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.predicates import SIDES
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.quality.behaviour import SPLITS
from kinegraph_training.data.clips import MotionClip, read_split

NEAR: Final = 0.3


@dataclass(frozen=True)
class Kind:
    """Sentences that ask for the same turn."""

    texts: tuple[str, ...]
    """With {side}, if they name one."""
    seconds: float
    degrees: float
    """What counts as asked for."""
    labels: tuple[str, ...] = ()
    """Labels of captured clips of such turns, with {side}."""


KINDS: Final[Mapping[str, Kind]] = {
    "turns while walking": Kind(
        ("a person walks forward and turns {side}", "a man walks, turning to the {side}", "he turns {side} on the way"),
        5.0, 90.0, ("walk-turn-{side}",),
    ),
    "turns on the spot": Kind(("a person turns {side}", "she turns to the {side}"), 3.0, 90.0, ("turn-{side}",)),
    "45 degrees": Kind(
        ("a person turns {side} by 45 degrees", "a person makes a 45 degree turn to the {side}"), 3.0, 45.0
    ),
    "90 degrees": Kind(("a person turns {side} by 90 degrees", "he does a quarter turn to the {side}"), 3.0, 90.0),
    "90 degrees while walking": Kind(("a person walks and turns {side} by 90 degrees",), 5.0, 90.0),
    "90 degrees, then a walk": Kind(("a person turns {side} by 90 degrees, then walks forward",), 6.0, 90.0),
    "180 degrees": Kind(
        ("a person turns {side} by 180 degrees", "a woman makes a half turn to the {side}"), 4.0, 180.0
    ),
    "turns around": Kind(
        ("a person turns around", "a person walks up, turns around and walks back"),
        5.0, 180.0, ("walk-u-turn-{side}", "turn-around-and-walk-{side}"),
    ),
    "turns all the way around": Kind(
        ("a person turns all the way around to the {side}", "a person turns {side} by 360 degrees"),
        5.0, 360.0, ("turn-in-place-{side}",),
    ),
    "walks in a circle": Kind(("a person walks in a circle to the {side}",), 8.0, 360.0, ("walk-circle-{side}",)),
}  # fmt: skip


class AsMade(MotionDecoder):
    """A decoder that leaves turns as the networks make them."""

    def decode(
        self,
        latents: FloatArray,
        options: Sequence[GenerateOptions],
        captions: Sequence[str],
        level: str = LEVELS[-1],
    ) -> list[Clip]:
        """Decode latents, see `MotionDecoder.decode`."""
        return super().decode(latents, [replace(sample, turn=None) for sample in options], captions, level)


def as_made(pipe: MotionPipeline) -> MotionPipeline:
    """Make a pipeline whose clips turn as the networks make them."""
    other, decoder = copy(pipe), pipe.decoder
    object.__setattr__(other, "decoder", AsMade(decoder.sessions, decoder.manifest, decoder.bones))
    return other


def towards(joints: FloatArray, side: str, text: str = "{side}") -> float:
    """Measure a turn towards a side, degrees; either way if the text names none."""
    sign = 1 if side == "left" else -1
    return turned_to(joints, sign if "{side}" in text else 0)


def generated_turns(pipe: MotionPipeline, kind: Kind, seeds: int) -> list[float]:
    """Measure the turns of all sentences of a kind, to both sides."""
    return [
        towards(pipe.generate(text.format(side=side), seconds=kind.seconds, seed=seed).joints, side, text)
        for text in kind.texts
        for side in (SIDES if "{side}" in text else SIDES[:1])
        for seed in range(seeds)
    ]


def captured_turns(clips: Sequence[MotionClip], kind: Kind) -> list[float]:
    """Measure the turns of captured clips of a kind."""
    labels = {label.format(side=side): side for label in kind.labels for side in SIDES}
    return [towards(clip.joints, labels[clip.action]) for clip in clips if clip.action in labels]


def summarise(turns: Sequence[float], asked: float) -> dict[str, Any]:
    """Compute median, tenth and ninetieth percentile, and the share that is near to what is asked for."""
    low, median, high = np.percentile(turns, [10, 50, 90])
    near = float(np.mean(np.abs(np.subtract(turns, asked)) <= NEAR * asked))
    return {"median": float(median), "low": float(low), "high": float(high), "near": near, "turns": list(turns)}


def measure(pipe: MotionPipeline, seeds: int) -> dict[str, Any]:
    """Measure every kind with a pipeline, as made and as given."""
    runs = {"made": as_made(pipe), "given": pipe}
    return {
        name: {run: summarise(generated_turns(way, kind, seeds), kind.degrees) for run, way in runs.items()}
        for name, kind in KINDS.items()
    }


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown: one row a kind, captured clips, and two columns a bundle."""
    heads = [f"{bundle}, {run}" for bundle in result["bundles"] for run in ("as made", "as given")]
    lines = [
        "Degrees towards the side that is asked for: median (10 % to 90 %), share near to what is asked for; "
        f"{result['seeds']} seeds a sentence",
        "",
        "| | captured | " + " | ".join(heads) + " |",
        "|---" * (2 + len(heads)) + "|",
    ]
    for name, turns in result["captured"].items():
        cells = ["-"]
        if turns:
            low, median, high = np.percentile(turns, [10, 50, 90])
            cells = [f"{median:.0f} ({low:.0f} to {high:.0f}), {len(turns)} clips"]
        for rows in result["bundles"].values():
            cells += [
                f"{row['median']:.0f} ({row['low']:.0f} to {row['high']:.0f}), {row['near']:.2f}"
                for row in rows[name].values()
            ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "out", seeds=10)
    parser.add_argument(
        "--bundles", nargs="+", default=[None], help="folders or names of bundles; the default bundle without it"
    )
    options = parser.parse_args()
    pipes = [MotionPipeline.load(bundle, threads=1) for bundle in options.bundles]
    clips = [clip for split in SPLITS for clip in read_split(options.data, split)]
    captured = {name: captured_turns(clips, kind) for name, kind in KINDS.items()}
    bundles = {f"{pipe.manifest.name} {pipe.manifest.version}": measure(pipe, options.seeds) for pipe in pipes}
    result = {"seeds": options.seeds, "captured": captured, "bundles": bundles}
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
