"""Make a clip of a bundle whenever a line is read, and answer with the peak memory so far: a process without torch.

    python -m kinegraph_benchmarks.speed.clip_process --bundle FOLDER --steps 15,15,20 --seconds 6 --threads 2

`speed.released_bundle` starts it, so that the memory it tells is that of the runtime alone.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from kinegraph import MotionPipeline
from kinegraph.bench import GRAPH
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser


def peak_memory() -> float:
    """Read the peak of this process's resident memory in MB; NaN where the system does not say."""
    status = Path("/proc/self/status")
    lines = status.read_text(encoding="utf-8").splitlines() if status.is_file() else []
    return next((float(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM:")), float("nan"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line: a clip for each line of standard input."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "bundle")
    parser.add_argument("--steps", required=True, help="of each level, such as 15,15,20")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args(arguments)
    steps = [int(part) for part in options.steps.split(",")]
    pipe = MotionPipeline.load(options.bundle, threads=options.threads)
    for _ in sys.stdin:
        pipe.generate(GRAPH, seconds=options.seconds, seed=1, steps=steps)
        print(peak_memory(), flush=True)


if __name__ == "__main__":
    main()
