"""Is an int8 bundle as good as the fp32 bundle of the same run, and faster? The gate of the default bundle.

    python -m kinegraph_benchmarks.quality.precision --reference FP32 --candidate INT8 --data DATA/bandai \
        --out precision.json

The same captions, lengths and noise through both. The candidate passes if behaviour and R-precision are no lower than
the interval of the reference over repeats, and if the minimum of its times is lower. Joint distances are reported.
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
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.label_classifier import Recogniser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.sample_cache import BundleModel, folder_of, generated
from kinegraph_benchmarks.common.scores import Judges, Reference, scores, summarised
from kinegraph_benchmarks.common.timing import in_one_process, summary
from kinegraph_benchmarks.quality.evaluate import long_enough
from kinegraph_training.data.clips import MotionClip, read_split

SPLIT = "dev_test"
GATED = ("behaviour", "r_precision_1")
SHOWN = (*GATED, "r_precision_3", "fid", "content", "style", "jerk", "foot_skate")
SENTENCE = "a person walks forward and waves the right hand"


def drawn(clips: Sequence[MotionClip], count: int) -> list[MotionClip]:
    """Some clips, the same ones every time."""
    chosen = np.random.default_rng(0).permutation(len(clips))[:count]
    return [clips[row] for row in sorted(chosen)]


def distances(ours: Sequence[FloatArray], theirs: Sequence[FloatArray]) -> dict[str, float]:
    """Mean distance of joints in mm: in the world, and relative to the pelvis over the floor."""
    floor = np.array([1.0, 0.0, 1.0], dtype=np.float32)

    def local(joints: FloatArray) -> FloatArray:
        return joints - joints[:, :1] * floor

    def mean(pairs: Sequence[tuple[FloatArray, FloatArray]]) -> list[float]:
        return [1000.0 * float(np.linalg.norm(one - other, axis=-1).mean()) for one, other in pairs]

    world = mean(list(zip(ours, theirs, strict=True)))
    posed = mean([(local(one), local(other)) for one, other in zip(ours, theirs, strict=True)])
    return {
        "world_mean": float(np.mean(world)),
        "world_p95": float(np.percentile(world, 95)),
        "local_mean": float(np.mean(posed)),
        "local_p95": float(np.percentile(posed, 95)),
    }


def quality(given: argparse.Namespace) -> dict[str, Any]:
    """Scores of both bundles over the same requests, and how far their joints are apart."""
    train = read_split(given.data, "train")
    lengths = np.mean([bone_lengths(clip.joints).mean(0) for clip in train], axis=0)
    judges = Judges(Evaluator(), Recogniser(train), lengths)
    clips = drawn(long_enough(read_split(given.data, SPLIT)), given.prompts)
    known = Reference(clips, judges.evaluator.motions([clip.joints for clip in clips]))
    made: dict[str, list[list[FloatArray]]] = {}
    rows: dict[str, list[dict[str, float]]] = {}
    for name in ("reference", "candidate"):
        model = BundleModel(getattr(given, name))
        folder = folder_of(model, given.work, SPLIT, clips, {})
        rng = np.random.default_rng(2)
        takes = [generated(model, clips, take, folder) for take in range(given.repeats)]
        made[name] = [motions for motions, _ in takes]
        rows[name] = [scores(motions, captions, known, judges, rng).numbers for motions, captions in takes]
        print(f"{name}: {rows[name][0]['r_precision_1']:.3f}", file=sys.stderr)
    pairs = [distances(one, other) for one, other in zip(made["reference"], made["candidate"], strict=True)]
    return {
        "prompts": len(clips),
        "repeats": given.repeats,
        "scores": {name: summarised(own) for name, own in rows.items()},
        "every_repeat": rows,
        "distance_mm": {key: float(np.mean([pair[key] for pair in pairs])) for key in pairs[0]},
    }


def speed(given: argparse.Namespace) -> dict[str, list[float]]:
    """Times of a 4 s clip from its graph, the two bundles taking turns."""
    pipes = {name: MotionPipeline.load(getattr(given, name), threads=1) for name in ("reference", "candidate")}
    graph = pipes["reference"].parse(SENTENCE)
    arms = {name: lambda pipe=pipe: pipe.generate(graph, seconds=4, seed=1) for name, pipe in pipes.items()}
    return in_one_process(arms, given.turns)


def verdict(result: dict[str, Any]) -> dict[str, bool]:
    """What the gate asks, one by one."""
    reference, candidate = result["scores"]["reference"], result["scores"]["candidate"]
    held = {name: candidate[name]["mean"] >= reference[name]["mean"] - reference[name]["plus_minus"] for name in GATED}
    return {**held, "faster": min(result["times_ms"]["candidate"]) < min(result["times_ms"]["reference"])}


def table(result: dict[str, Any]) -> str:
    """Markdown."""
    lines = [f"{result['prompts']} captions of {SPLIT}, {result['repeats']} repeats, the same noise.", ""]
    lines += ["| | reference | candidate |", "|---|---|---|"]
    for name in SHOWN:
        cells = [
            f"{own[name]['mean']:.3f} ± {own[name]['plus_minus']:.3f}"
            for own in (result["scores"]["reference"], result["scores"]["candidate"])
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    far = result["distance_mm"]
    world, local = (f"{far[f'{which}_mean']:.1f} mm (95 %: {far[f'{which}_p95']:.1f})" for which in ("world", "local"))
    lines += ["", f"Joints apart: {world} in the world, {local} around the pelvis.", ""]
    lines += [summary(result["times_ms"], against="reference"), ""]
    passed = ", ".join(f"{name} {'yes' if held else 'NO'}" for name, held in result["gate"].items())
    return "\n".join([*lines, f"Gate: {passed}."]) + "\n"


def main() -> int:
    """0: passes; 1: does not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=Path, required=True, help="folder of the fp32 bundle")
    parser.add_argument("--candidate", type=Path, required=True, help="folder of the int8 bundle")
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--work", type=Path, default=Path("evaluation"), help="folder for generated clips")
    parser.add_argument("--prompts", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--turns", type=int, default=30, help="timed repeats")
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    result = {"machine": machine(), **quality(given), "times_ms": speed(given)}
    result["gate"] = verdict(result)
    write_report(given.out, result, table(result))
    return 0 if all(result["gate"].values()) else 1


if __name__ == "__main__":
    sys.exit(main())
