"""The same clips on another kind of CPU: how far apart are their joints?

    python -m kinegraph_benchmarks.speed.cross_platform --bundle FP32 \
        --save clips.npz                      on one machine
    python -m kinegraph_benchmarks.speed.cross_platform --bundle FP32 --against clips.npz --out cpu.json    on the other

From graphs, so without spaCy: numpy, onnxruntime and tokenizers are enough on the other machine, which may be an
emulated one (qemu-user 10 runs the aarch64 wheels in five minutes; 7.2 does not). The text encoder rounds to int8 in
every bundle, and processors do that differently; so clips are also made from the text as the first machine encoded it,
and these agree to a thousandth of a millimetre in an fp32 bundle.
"""

from __future__ import annotations

import argparse
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph import Concept, MotionPipeline
from kinegraph.bench import GRAPH, machine
from kinegraph.edits import with_weight
from kinegraph_benchmarks.common.report_io import write_report

SECONDS, SEED = 2.0, 5
PARTS = ("hidden", "pooled")
"""Of what the text encoder says."""
Feeds = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class KeptText:
    """In place of the text encoder's session: remembers what it said, and says again what is known."""

    inner: Any
    known: dict[str, list[NDArray[np.float32]]]
    """Token ids of a caption -> hidden states and sentence."""

    def run(self, names: Sequence[str], feeds: Feeds) -> list[NDArray[np.float32]]:
        ids = " ".join(map(str, feeds["input_ids"][0]))
        if ids not in self.known:
            self.known[ids] = self.inner.run(names, feeds)
        return self.known[ids]


def with_kept_text(pipe: MotionPipeline, known: dict[str, list[NDArray[np.float32]]]) -> MotionPipeline:
    """Cache encoder outputs: captions in `known` are not encoded, and those that are come into it."""
    sessions = pipe.encoder.sessions
    return pipe.with_sessions(replace(sessions, text_encoder=KeptText(sessions.text_encoder, known)))


def made(pipe: MotionPipeline) -> dict[str, Any]:
    """Kind of call -> joints (frames, 22, 3)."""
    given: dict[str, Any] = {"seconds": SECONDS, "seed": SEED}
    weighted = with_weight(GRAPH, GRAPH.nodes[-1].text, 0.5)
    clips = {
        "generate": pipe.generate(GRAPH, **given),
        "without the foot fix": pipe.generate(GRAPH, foot_fix=False, **given),
        "a weighted edge": pipe.generate(weighted, **given),
        "compose": pipe.compose([Concept(GRAPH), Concept(weighted, -0.5)], text=GRAPH, **given),
        "a batch": pipe.batch([GRAPH, GRAPH], **given)[1],
    }
    return {name: clip.joints for name, clip in clips.items()}


def saved(pipe: MotionPipeline) -> dict[str, Any]:
    """Clips by kind of call, and what the text encoder said of their captions."""
    known: dict[str, list[NDArray[np.float32]]] = {}
    pipe = with_kept_text(pipe, known)
    clips = made(pipe)
    return clips | {f"{part} {ids}": said[k] for ids, said in known.items() for k, part in enumerate(PARTS)}


def compared(pipe: MotionPipeline, theirs: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, dict[str, float]]]:
    """How far joints are apart, mm: whose text -> kind of call -> mean and max."""
    found = {"own text": made(pipe)}
    captions = {name.split(" ", 1)[1] for name in theirs if name.startswith(PARTS[0] + " ")}
    pipe = with_kept_text(pipe, {ids: [theirs[f"{part} {ids}"] for part in PARTS] for ids in captions})
    found["the other machine's text"] = made(pipe)
    return {
        whose: {name: distance(joints, theirs[name]) for name, joints in own.items()} for whose, own in found.items()
    }


def distance(joints: NDArray[np.float32], others: NDArray[np.float32]) -> dict[str, float]:
    """Of joints, mm."""
    far = 1000.0 * np.linalg.norm(joints - others, axis=-1)
    return {"mean": float(far.mean()), "max": float(far.max())}


def table(kinds: str, apart: dict[str, dict[str, dict[str, float]]]) -> str:
    """Markdown."""
    lines = [f"{kinds}; joints apart, mm, mean (max).", "", "| | " + " | ".join(apart) + " |", "|---|---|---|"]
    for name in next(iter(apart.values())):
        cells = [f"{own[name]['mean']:.4f} ({own[name]['max']:.4f})" for own in apart.values()]
        lines.append(f"| {name} | {cells[0]} | {cells[1]} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--save", type=Path, help="keep the clips here")
    parser.add_argument("--against", type=Path, help="clips that another machine kept")
    parser.add_argument("--out", type=Path, help="JSON file of the comparison; a .md file is written beside it")
    given = parser.parse_args()
    if (given.save is None) == (given.against is None) or (given.against is None) != (given.out is None):
        parser.error("give either --save, or --against and --out")
    pipe = MotionPipeline.load(given.bundle, threads=1)
    if given.save is not None:
        np.savez(given.save, kind=platform.machine(), **saved(pipe))
        return
    theirs = np.load(given.against)
    apart = compared(pipe, theirs)
    kinds = f"{platform.machine()} against {theirs['kind']}, {pipe.manifest.precision}"
    write_report(given.out, {"machine": machine(), "kinds": kinds, "apart_mm": apart}, table(kinds, apart))


if __name__ == "__main__":
    main()
