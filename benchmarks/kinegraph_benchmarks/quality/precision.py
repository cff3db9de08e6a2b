"""Check that an int8 bundle is as good as the fp32 bundle of the same run, and faster: the gate of the default bundle.

    python -m kinegraph_benchmarks.quality.precision --reference FP32 --candidate INT8 --data DATA/bandai \
        --out precision.json

Both get the same captions, lengths and noise. The candidate passes if behaviour and R-precision are no lower than
the interval of the reference over repeats, and if the minimum of its times is lower. Joint distances are reported only.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.bench import machine
from kinegraph.motion.skeleton import bone_lengths
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.label_classifier import LabelClassifier
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.sample_cache import BundleModel, cache_folder, load_or_generate, long_enough
from kinegraph_benchmarks.common.scores import Judges, Reference, average_repeats, score_motions
from kinegraph_benchmarks.common.timing import time_interleaved, timing_table
from kinegraph_training.data.clips import MotionClip, read_split

SPLIT = "dev_test"
GATED = ("behaviour", "r_precision_1")
SHOWN = (*GATED, "r_precision_3", "fid", "content", "style", "jerk", "foot_skate")
SENTENCE = "a person walks forward and waves the right hand"


def sample_clips(clips: Sequence[MotionClip], count: int) -> list[MotionClip]:
    """Draw some clips, the same ones every time."""
    chosen = np.random.default_rng(0).permutation(len(clips))[:count]
    return [clips[row] for row in sorted(chosen)]


def joint_distances(ours: Sequence[FloatArray], theirs: Sequence[FloatArray]) -> dict[str, float]:
    """Measure the distance of joints, mm: in the world, and relative to the pelvis over the floor.

    Args:
        ours: joints (frames, 22, 3) of each clip, metres.
        theirs: the same clips by the other bundle.

    Returns:
        Mean and 95th percentile over clips of each clip's mean distance.
    """
    floor = np.array([1.0, 0.0, 1.0], dtype=np.float32)

    def local(joints: FloatArray) -> FloatArray:
        return joints - joints[:, :1] * floor

    def mean(pairs: Sequence[tuple[FloatArray, FloatArray]]) -> list[float]:
        return [1000.0 * float(np.linalg.norm(a - b, axis=-1).mean()) for a, b in pairs]

    world = mean(list(zip(ours, theirs, strict=True)))
    posed = mean([(local(a), local(b)) for a, b in zip(ours, theirs, strict=True)])
    return {
        "world_mean": float(np.mean(world)),
        "world_p95": float(np.percentile(world, 95)),
        "local_mean": float(np.mean(posed)),
        "local_p95": float(np.percentile(posed, 95)),
    }


def compare_quality(options: argparse.Namespace) -> dict[str, Any]:
    """Score both bundles on the same requests, and measure how far their joints are apart."""
    train = read_split(options.data, "train")
    lengths = np.mean([bone_lengths(clip.joints).mean(0) for clip in train], axis=0)
    judges = Judges(Evaluator(), LabelClassifier(train), lengths)
    clips = sample_clips(long_enough(read_split(options.data, SPLIT)), options.prompts)
    reference = Reference(clips, judges.evaluator.embed_motions([clip.joints for clip in clips]))
    motions_of: dict[str, list[list[FloatArray]]] = {}
    rows: dict[str, list[dict[str, float]]] = {}
    for name in ("reference", "candidate"):
        model = BundleModel(getattr(options, name))
        folder = cache_folder(model, options.work, SPLIT, clips, {})
        rng = np.random.default_rng(2)
        takes = [load_or_generate(model, clips, take, folder) for take in range(options.repeats)]
        motions_of[name] = [motions for motions, _ in takes]
        rows[name] = [score_motions(motions, captions, reference, judges, rng).metrics for motions, captions in takes]
        print(f"{name}: {rows[name][0]['r_precision_1']:.3f}", file=sys.stderr)
    pairs = [joint_distances(*takes) for takes in zip(motions_of["reference"], motions_of["candidate"], strict=True)]
    return {
        "prompts": len(clips),
        "repeats": options.repeats,
        "scores": {name: average_repeats(scores) for name, scores in rows.items()},
        "every_repeat": rows,
        "distance_mm": {key: float(np.mean([pair[key] for pair in pairs])) for key in pairs[0]},
    }


def compare_speed(options: argparse.Namespace) -> dict[str, list[float]]:
    """Time a 4 s clip from its graph, the two bundles taking turns; milliseconds of every repeat."""
    pipes = {name: MotionPipeline.load(getattr(options, name), threads=1) for name in ("reference", "candidate")}
    graph = pipes["reference"].parse(SENTENCE)
    arms = {name: lambda pipe=pipe: pipe.generate(graph, seconds=4, seed=1) for name, pipe in pipes.items()}
    return time_interleaved(arms, options.turns)


def check_gate(result: dict[str, Any]) -> dict[str, bool]:
    """Check every condition of the gate: each gated score within the reference's interval, and a lower minimum time."""
    reference, candidate = result["scores"]["reference"], result["scores"]["candidate"]
    held = {name: candidate[name]["mean"] >= reference[name]["mean"] - reference[name]["plus_minus"] for name in GATED}
    return {**held, "faster": min(result["times_ms"]["candidate"]) < min(result["times_ms"]["reference"])}


def markdown_table(result: dict[str, Any]) -> str:
    """Format a result as Markdown."""
    lines = [f"{result['prompts']} captions of {SPLIT}, {result['repeats']} repeats, the same noise.", ""]
    lines += ["| | reference | candidate |", "|---|---|---|"]
    for name in SHOWN:
        cells = [
            f"{scores[name]['mean']:.3f} ± {scores[name]['plus_minus']:.3f}"
            for scores in (result["scores"]["reference"], result["scores"]["candidate"])
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    far = result["distance_mm"]
    world, local = (f"{far[f'{frame}_mean']:.1f} mm (95 %: {far[f'{frame}_p95']:.1f})" for frame in ("world", "local"))
    lines += ["", f"Joints apart: {world} in the world, {local} around the pelvis.", ""]
    lines += [timing_table(result["times_ms"], against="reference"), ""]
    passed = ", ".join(f"{name} {'yes' if held else 'NO'}" for name, held in result["gate"].items())
    return "\n".join([*lines, f"Gate: {passed}."]) + "\n"


def main() -> int:
    """Run the command line: 0 if the candidate passes, 1 if it does not."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "work", "out", repeats=5)
    parser.add_argument("--reference", type=Path, required=True, help="folder of the fp32 bundle")
    parser.add_argument("--candidate", type=Path, required=True, help="folder of the int8 bundle")
    parser.add_argument("--prompts", type=int, default=100, help="captions (100)")
    parser.add_argument("--turns", type=int, default=30, help="timed repeats")
    options = parser.parse_args()
    result = {"machine": machine(), **compare_quality(options), "times_ms": compare_speed(options)}
    result["gate"] = check_gate(result)
    write_report(options.out, result, markdown_table(result))
    return 0 if all(result["gate"].values()) else 1


if __name__ == "__main__":
    sys.exit(main())
