"""The same clips on another kind of CPU: how far apart are their joints?

    python benchmarks/other_cpu.py --bundle FP32 --save clips.npz                      on one machine
    python benchmarks/other_cpu.py --bundle FP32 --against clips.npz --out cpu.json    on the other

From graphs, so without spaCy: numpy, onnxruntime and tokenizers are enough on the other machine, which may be an
emulated one (qemu-user 10 loads the aarch64 wheels, slowly; 7.2 does not). Processors round differently, and int8
bundles round more: an fp32 bundle should agree to a millimetre, an int8 one about as well as with itself in a batch
(`batch_mm` of `kinegraph info`).
"""

from __future__ import annotations

import argparse
import platform
from pathlib import Path
from typing import Any

import numpy as np
from written import written

from kinegraph import Concept, MotionPipeline
from kinegraph.bench import GRAPH, machine
from kinegraph.edits import with_weight

SECONDS, SEED = 2.0, 5


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
    pipe = MotionPipeline.load(given.bundle)
    clips = made(pipe)
    if given.save is not None:
        np.savez(given.save, kind=platform.machine(), **clips)
        return
    theirs = np.load(given.against)
    far = {name: 1000.0 * np.linalg.norm(joints - theirs[name], axis=-1) for name, joints in clips.items()}
    apart = {name: {"mean": float(each.mean()), "max": float(each.max())} for name, each in far.items()}
    kinds = f"{platform.machine()} against {theirs['kind']}, {pipe.manifest.precision}"
    lines = [f"{kinds}; joints apart, mm.", "", "| | mean | max |", "|---|---|---|"]
    lines += [f"| {name} | {each['mean']:.4f} | {each['max']:.4f} |" for name, each in apart.items()]
    written(given.out, {"machine": machine(), "kinds": kinds, "apart_mm": apart}, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
