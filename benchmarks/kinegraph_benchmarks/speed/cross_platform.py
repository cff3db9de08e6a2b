"""Measure how far joints differ when another kind of CPU generates the same clips.

    python -m kinegraph_benchmarks.speed.cross_platform --bundle FP32 --save clips.npz       (on one machine)
    python -m kinegraph_benchmarks.speed.cross_platform --bundle FP32 --against clips.npz \
        --out other_cpu.json                                                                (on the other)

Clips are generated from graphs, so without spaCy: numpy, onnxruntime and tokenizers are enough on the other machine,
which may be an emulated one (qemu-user 10 runs the aarch64 wheels in five minutes; 7.2 does not). The text encoder
rounds to int8 in every bundle, and processors do that differently. So clips are also generated from the text as the
first machine encoded it, and these agree to a thousandth of a millimetre in an fp32 bundle.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph import Concept, MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.bench import GRAPH, machine
from kinegraph.edits import with_weight
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report

SECONDS, SEED = 2.0, 5
TEXT_OUTPUTS = ("hidden", "pooled")
"""Outputs of the text encoder."""
Feeds = Mapping[str, NDArray[Any]]
EncodedCaptions = dict[str, list[FloatArray]]
"""Token ids of a caption -> hidden states and sentence vector."""


@dataclass(frozen=True)
class CachedTextEncoder:
    """Stand-in for the text encoder's session that runs it only for captions that are not cached."""

    session: Any
    cache: EncodedCaptions

    def run(self, names: Sequence[str], feeds: Feeds) -> list[FloatArray]:
        """Look up one caption's outputs, or encode it."""
        ids = " ".join(map(str, feeds["input_ids"][0]))
        if ids not in self.cache:
            self.cache[ids] = self.session.run(names, feeds)
        return self.cache[ids]


def cache_text_encoder(pipe: MotionPipeline, cache: EncodedCaptions) -> MotionPipeline:
    """Make a pipeline that takes encoded captions from `cache`, and adds to it those that it has to encode."""
    sessions = pipe.encoder.sessions
    return pipe.with_sessions(replace(sessions, text_encoder=CachedTextEncoder(sessions.text_encoder, cache)))


def generate_clips(pipe: MotionPipeline) -> dict[str, Any]:
    """Generate a clip with each kind of call; joints (frames, 22, 3) by kind."""
    length: dict[str, Any] = {"seconds": SECONDS, "seed": SEED}
    weighted = with_weight(GRAPH, GRAPH.nodes[-1].text, 0.5)
    clips = {
        "generate": pipe.generate(GRAPH, **length),
        "without the foot fix": pipe.generate(GRAPH, foot_fix=False, **length),
        "a weighted edge": pipe.generate(weighted, **length),
        "compose": pipe.compose([Concept(GRAPH), Concept(weighted, -0.5)], text=GRAPH, **length),
        "a batch": pipe.batch([GRAPH, GRAPH], shared_run=True, **length)[1],
    }
    return {name: clip.joints for name, clip in clips.items()}


def clips_and_encoded_text(pipe: MotionPipeline) -> dict[str, Any]:
    """Generate clips by kind of call, with the text encoder's outputs for their captions: arrays of the saved file."""
    cache: EncodedCaptions = {}
    clips = generate_clips(cache_text_encoder(pipe, cache))
    return clips | {
        f"{name} {ids}": outputs[index] for ids, outputs in cache.items() for index, name in enumerate(TEXT_OUTPUTS)
    }


def compare_clips(pipe: MotionPipeline, theirs: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, dict[str, float]]]:
    """Measure how far joints are apart, mm: whose text -> kind of call -> mean and max.

    Args:
        pipe: the bundle on this machine.
        theirs: the other machine's file (`clips_and_encoded_text`).
    """
    ours = {"own text": generate_clips(pipe)}
    captions = {name.split(" ", 1)[1] for name in theirs if name.startswith(TEXT_OUTPUTS[0] + " ")}
    cache = {ids: [theirs[f"{name} {ids}"] for name in TEXT_OUTPUTS] for ids in captions}
    ours["the other machine's text"] = generate_clips(cache_text_encoder(pipe, cache))
    return {
        text: {kind: joint_distance(joints, theirs[kind]) for kind, joints in clips.items()}
        for text, clips in ours.items()
    }


def joint_distance(joints: FloatArray, others: FloatArray) -> dict[str, float]:
    """Measure mean and maximum distance of joints (frames, 22, 3), mm."""
    distance = 1000.0 * np.linalg.norm(joints - others, axis=-1)
    return {"mean": float(distance.mean()), "max": float(distance.max())}


def markdown_table(kinds: str, apart: dict[str, dict[str, dict[str, float]]]) -> str:
    """Format distances as Markdown."""
    lines = [f"{kinds}; joints apart, mm, mean (max).", "", "| | " + " | ".join(apart) + " |", "|---|---|---|"]
    for name in next(iter(apart.values())):
        cells = [f"{clips[name]['mean']:.4f} ({clips[name]['max']:.4f})" for clips in apart.values()]
        lines.append(f"| {name} | {cells[0]} | {cells[1]} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "bundle", "out", optional=("out",))
    parser.add_argument("--save", type=Path, help="write the clips to this file")
    parser.add_argument("--against", type=Path, help="compare with the clips that another machine wrote")
    options = parser.parse_args()
    if (options.save is None) == (options.against is None) or (options.against is None) != (options.out is None):
        parser.error("give either --save, or --against and --out")
    pipe = MotionPipeline.load(options.bundle, threads=1)
    if options.save is not None:
        np.savez(options.save, kind=platform.machine(), **clips_and_encoded_text(pipe))
        return
    theirs = np.load(options.against)
    apart = compare_clips(pipe, theirs)
    kinds = f"{platform.machine()} against {theirs['kind']}, {pipe.manifest.precision}"
    write_report(options.out, {"machine": machine(), "kinds": kinds, "apart_mm": apart}, markdown_table(kinds, apart))


if __name__ == "__main__":
    main()
