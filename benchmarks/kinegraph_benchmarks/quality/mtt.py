"""Measure composition on timelines in MTT's way: skeleton beside latent space, with and without AGD, and SEF's shares.

    python -m kinegraph_benchmarks.quality.mtt --data DATA/bandai --out mtt.json

    ... --tables timelines          some rows only: one_text, composed, timelines (all)
    ... --evaluator EVALUATOR       folder of another one, such as `train_evaluator --leave-out` makes
    ... --timelines N               timelines (500)
    ... --mtt STMC/mtt              MTT's own files, and --motions FOLDER for its captured motions

Three held-out texts make a timeline (`common.mtt_set`). Rows of `one_text` are one sentence of all three (EnergyMoGen,
Tables 3, 6 and 9), rows of `composed` three concepts of one clip (Tables 3 and 7), rows of `timelines` keep the times
of the intervals, in latent space by what coincides and in skeleton space each text on its own frames and parts of the
body (Eq. 11). Scores are those of STMC (`common.mtt_scores`), by the evaluator of `quality.evaluate`. Rows that the
bundle cannot make are left out, and named. A stopped run continues after its last row. Writes JSON, and a Markdown
table beside it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import FRAMES
from kinegraph.errors import InvalidInputError
from kinegraph.intervals import Interval
from kinegraph.options import LATENT
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.evaluator import FOLDER, Evaluator
from kinegraph_benchmarks.common.mtt_scores import MttJudge
from kinegraph_benchmarks.common.mtt_set import (
    TIMELINES,
    MttSet,
    MttTimeline,
    draw_timelines,
    read_mtt,
    texts_of_clips,
)
from kinegraph_benchmarks.common.report_io import write_json, write_report
from kinegraph_benchmarks.common.sample_cache import long_enough
from kinegraph_benchmarks.quality.evaluate import splits_of
from kinegraph_training.data.clips import MotionClip, read_split

OVERLAP: Final = 0.5
"""Seconds that neighbours of a timeline share: MTT's intervals have 9.2 s at most, and models 9.8 s."""
PAPER_STEP_SIZES: Final = ((0.1, 0.2), (0.01, 0.02), (0.005, 0.01), (0.005, 0.005), (0.001, 0.002))
"""Step sizes of AGD, gamma_attn and gamma_reg (EnergyMoGen, Table 9)."""
BEST_STEP_SIZES: Final = (0.001, 0.002)
PAPER_LAMBDAS: Final = (
    (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.5, 0.5, 0.0), (0.4, 0.6, 0.0), (0.3, 0.7, 0.0),
    (0.2, 0.8, 0.0), (0.1, 0.9, 0.0), (0.3, 0.4, 0.3), (0.2, 0.5, 0.3), (0.1, 0.7, 0.2), (0.1, 0.8, 0.1),
)  # fmt: skip
"""Shares of latent, semantic and joint text (EnergyMoGen, Table 7)."""
SKELETON_LAMBDAS: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.1, 0.7, 0.2))
TABLES: Final = ("one_text", "composed", "timelines")
COLUMNS: Final = {
    "r_precision_1": ("R@1", 100, 1),
    "r_precision_3": ("R@3", 100, 1),
    "motion_text_score": ("M2T", 1, 3),
    "motion_motion_score": ("M2M", 1, 3),
    "fid": ("FID", 1, 3),
    "transition": ("transition, cm", 100, 2),
}
"""Score -> title, factor and digits, in the papers' order and units."""
SPACES: Final = {LATENT: "latent", FRAMES: "skeleton"}

Make = Callable[[MotionPipeline, MttTimeline, int], FloatArray]
"""Bundle, timeline, seed -> joints (frames, 22, 3)."""


@dataclass(frozen=True)
class Row:
    """A way to make motions of timelines."""

    table: str
    """Of `TABLES`."""
    make: Make
    space: str
    agd: bool = False

    @property
    def whole(self) -> bool:
        """Whether each text holds for the whole motion."""
        return self.table != "timelines"

    def fits(self, pipe: MotionPipeline) -> bool:
        """Tell whether a bundle can make it."""
        in_frames = self.space == FRAMES
        has_agd = bool(pipe.sampler.sessions.denoiser_agd) or in_frames
        return (pipe.manifest.frames_part is not None or not in_frames) and (has_agd or not self.agd)


def one_sentence(timeline: MttTimeline) -> str:
    """Say all three texts in one sentence, as MTT's baseline of one text does."""
    first, second, beside = timeline.texts
    return f"{first} and then {second} while {beside}"


def clip_seconds(pipe: MotionPipeline, timeline: MttTimeline) -> float:
    """Take the length of a timeline, as far as one clip of the bundle goes."""
    return min(timeline.seconds, pipe.manifest.seconds_limits[1])


def make_one_text(space: str, agd: tuple[float, float] | None = None) -> Make:
    """Make one clip of one sentence, with adaptive gradient descent if asked."""

    def make(pipe: MotionPipeline, timeline: MttTimeline, seed: int) -> FloatArray:
        text, seconds = one_sentence(timeline), clip_seconds(pipe, timeline)
        return pipe.compose([text], agd=agd, seconds=seconds, seed=seed, space=space).joints

    return make


def make_composed(space: str, lambdas: tuple[float, float, float] | None) -> Make:
    """Make one clip of three concepts; None takes the default shares."""

    def make(pipe: MotionPipeline, timeline: MttTimeline, seed: int) -> FloatArray:
        text, seconds = one_sentence(timeline), clip_seconds(pipe, timeline)
        concepts = list(timeline.texts)
        return pipe.compose(concepts, text=text, lambdas=lambdas, seconds=seconds, seed=seed, space=space).joints

    return make


def make_single_track(*, composed: bool) -> Make:
    """Make a timeline of latent space: where its intervals begin or end, a new part; texts at once, joined or composed.

    Joined by "while" they are the single track of MTT's baselines.
    """

    def make(pipe: MotionPipeline, timeline: MttTimeline, seed: int) -> FloatArray:
        track = [
            Interval(text, start, end)
            for start, end, texts in single_track(timeline, pipe.manifest.seconds_limits[0])
            for text in (texts if composed else [" while ".join(texts)])
        ]
        return pipe.timeline(track, seed=seed).joints

    return make


def make_timeline(*, parts: bool) -> Make:
    """Make a timeline of skeleton space, each text for its parts of the body or for the whole of it."""

    def make(pipe: MotionPipeline, timeline: MttTimeline, seed: int) -> FloatArray:
        intervals = [
            Interval(each.text, each.start, each.end, each.parts if parts else ()) for each in timeline.intervals
        ]
        return pipe.timeline(intervals, overlap=OVERLAP, seed=seed, space=FRAMES).joints

    return make


def single_track(timeline: MttTimeline, least: float) -> list[tuple[float, float, list[str]]]:
    """Cut a timeline where an interval begins or ends.

    Args:
        timeline: of three intervals.
        least: seconds of the shortest piece; a cut nearer to the change from first to second, or to an end, is left
            out.

    Returns:
        Start, end and texts of each piece: those that hold for most of it.
    """
    cuts = [0.0, timeline.seconds, timeline.first.end]
    for moment in (timeline.beside.start, timeline.beside.end):
        if all(abs(moment - cut) >= least for cut in cuts):
            cuts.append(moment)
    cuts.sort()
    pieces = []
    for start, end in pairwise(cuts):
        texts = [
            each.caption
            for each in timeline.intervals
            if min(each.end, end) - max(each.start, start) > (end - start) / 2
        ]
        pieces.append((start, end, texts))
    return pieces


def list_rows() -> dict[str, Row]:
    """List all rows by name."""
    rows: dict[str, Row] = {}
    for space, name in SPACES.items():
        rows[f"one text, {name}"] = Row("one_text", make_one_text(space), space)
        for sizes in PAPER_STEP_SIZES if space == LATENT else (BEST_STEP_SIZES,):
            label = f"one text, {name}, AGD {sizes[0]:g}/{sizes[1]:g}"
            rows[label] = Row("one_text", make_one_text(space, sizes), space, agd=True)
    for space, name in SPACES.items():
        for lambdas in PAPER_LAMBDAS if space == LATENT else SKELETON_LAMBDAS:
            label = f"composed, {name}, " + "/".join(f"{share:g}" for share in lambdas)
            rows[label] = Row("composed", make_composed(space, lambdas), space)
        rows[f"composed, {name}, default"] = Row("composed", make_composed(space, None), space)
    rows["single track, latent"] = Row("timelines", make_single_track(composed=False), LATENT)
    rows["composed track, latent"] = Row("timelines", make_single_track(composed=True), LATENT)
    rows["timeline of whole bodies, skeleton"] = Row("timelines", make_timeline(parts=False), FRAMES)
    rows["timeline, skeleton"] = Row("timelines", make_timeline(parts=True), FRAMES)
    return rows


def measure_row(row: Row, pipe: MotionPipeline, judge: MttJudge) -> dict[str, float]:
    """Make a motion of every timeline, of seeds from 0 on, and score them."""
    motions = [row.make(pipe, timeline, seed) for seed, timeline in enumerate(judge.mtt.timelines)]
    return judge.score(motions, whole=row.whole)


def held_out_clips(data: Path) -> list[MotionClip]:
    """Read the captured clips of a data folder that no model was trained on."""
    return long_enough([clip for split in splits_of(data) for clip in read_split(data, split)])


def load_set(data: Path | None, mtt: Path | None, motions: Path | None, count: int) -> tuple[MttSet, list[FloatArray]]:
    """Draw timelines from held-out clips, or read MTT's own.

    Returns:
        The set, and captured motions for the FID; of MTT none but those of its texts.

    Raises:
        InvalidInputError: neither folder is given, or they hold no such set.
    """
    if mtt is not None:
        read = read_mtt(mtt, motions)
        return MttSet(read.texts, read.timelines[:count]), []
    if data is None:
        raise InvalidInputError("give --data, a folder of captured motion, or --mtt, the folder of MTT's files")
    clips = held_out_clips(data)
    texts = texts_of_clips(clips)
    return MttSet(tuple(texts), draw_timelines(texts, count)), [clip.joints for clip in clips]


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown."""
    lines = [
        f"{result['bundle']}, evaluator {result['evaluator']}: {result['timelines']} timelines of"
        f" {result['texts']} texts",
        "",
        "| | " + " | ".join(title for title, _, _ in COLUMNS.values()) + " |",
        "|---" * (1 + len(COLUMNS)) + "|",
    ]
    for name, scores in result["rows"].items():
        cells = [
            f"{factor * scores[key]:.{digits}f}" if key in scores else "-"
            for key, (_, factor, digits) in COLUMNS.items()
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    if result["left_out"]:
        lines += ["", f"Not in this bundle: {'; '.join(result['left_out'])}."]
    return "\n".join(lines) + "\n"


def measure(
    pipe: MotionPipeline, judge: MttJudge, tables: Sequence[str], out: Path, rows: Mapping[str, Row]
) -> dict[str, Any]:
    """Measure rows that `out` does not have yet, and write it after each."""
    result: dict[str, Any] = {
        "bundle": f"{pipe.manifest.name} {pipe.manifest.version}",
        "evaluator": judge.evaluator.version,
        "texts": len(judge.mtt.texts),
        "timelines": len(judge.mtt.timelines),
    }
    stored = json.loads(out.read_text(encoding="utf-8")) if out.is_file() else {}
    is_same = all(stored.get(key) == value for key, value in result.items())
    result |= {"rows": stored["rows"] if is_same else {}, "left_out": []}
    if judge.motions is not None:
        result["rows"].setdefault("captured", judge.score_captured())
    for name, row in rows.items():
        if row.table not in tables or name in result["rows"]:
            continue
        if not row.fits(pipe):
            result["left_out"].append(name)
            continue
        result["rows"][name] = measure_row(row, pipe, judge)
        print(f"{name}: R@1 {100 * result['rows'][name]['r_precision_1']:.1f}", file=sys.stderr)
        write_json(out, result)
    return result


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=TABLES, help="rows that are measured (all)")
    parser.add_argument("--timelines", type=int, default=TIMELINES, help=f"timelines ({TIMELINES})")
    parser.add_argument("--mtt", type=Path, help="folder mtt of STMC's repository, instead of --data")
    parser.add_argument("--motions", type=Path, help="folder of AMASS joints as STMC extracts them, for --mtt")
    add_arguments(parser, "data", "bundle", "out", optional=("data",))
    parser.add_argument("--evaluator", type=Path, default=FOLDER, help="folder that export_evaluator wrote")
    options = parser.parse_args()
    mtt, captured = load_set(options.data, options.mtt, options.motions, options.timelines)
    judge = MttJudge.of(mtt, Evaluator(options.evaluator), captured)
    pipe = MotionPipeline.load(options.bundle, threads=1)
    result = measure(pipe, judge, options.tables, options.out, list_rows())
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
