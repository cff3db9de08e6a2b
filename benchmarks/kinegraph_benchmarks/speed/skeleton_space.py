"""Time and weigh a clip in skeleton space beside one in latent space, and beside MDM in eager torch.

    python -m kinegraph_benchmarks.speed.skeleton_space --bundle BUNDLE --out skeleton_space.json [--quick]

All make 4 s of motion from one graph, on one thread. The bundle's own clips are `MotionPipeline.generate`, whole, from
graph to joints. MDM (Tevet et al., 2023) is its denoiser in eager torch alone, without CLIP before and joints after it:
8 encoder layers of width 512 over 80 frames of 263 features, random weights, a conditional and an unconditional row, 50
steps as its fast model takes and 20 as our skeleton space takes. Each arm's peak memory is that of a process of its
own, which has made one clip.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.bench import GRAPH, machine
from kinegraph.bundle.contract import FRAMES
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.timing import Arm, time_interleaved, timing_table
from kinegraph_benchmarks.speed.clip_process import peak_memory

SECONDS, FPS, FEATURES = 4.0, 20, 263
MDM_STEPS = {"MDM, eager torch, 50 steps": 50, "MDM, eager torch, 20 steps": 20}
SPACES = {"latent space": "latent", "skeleton space": FRAMES}
ARMS = (*SPACES, *MDM_STEPS)


def make_arm(name: str, bundle: str | None) -> Arm:
    """Load what an arm of `ARMS` needs; calling it makes one clip."""
    if name in SPACES:
        pipe = MotionPipeline.load(bundle, threads=1)
        return lambda: pipe.generate(GRAPH, seconds=SECONDS, seed=1, space=SPACES[name])
    return mdm_arm(MDM_STEPS[name])


def mdm_arm(steps: int) -> Callable[[], object]:
    """Make MDM's sampling loop in eager torch, with random weights."""
    import torch

    from kinegraph_benchmarks.speed.released_size import MdmStep

    torch.set_num_threads(1)
    torch.manual_seed(1)
    step = MdmStep().eval()
    noise = torch.randn(1, round(SECONDS * FPS), FEATURES)

    @torch.no_grad()
    def sample() -> torch.Tensor:
        motion = noise
        for _ in range(steps):
            conditional, unconditional = step(motion.expand(2, -1, -1))
            motion = (unconditional + 2.5 * (conditional - unconditional))[None]
        return motion

    return sample


def memory_of(name: str, bundle: str | None) -> float:
    """Measure the peak memory, MB, of a process that makes one clip of an arm."""
    context = get_context("spawn")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=_send_memory, args=(name, bundle, send))
    process.start()
    send.close()  # so that the end of a process that failed is an error here, and not a wait for ever
    megabytes = float(receive.recv())
    process.join()
    return megabytes


def _send_memory(name: str, bundle: str | None, send: Connection) -> None:
    make_arm(name, bundle)()
    send.send(peak_memory())


def measure(bundle: str | None, repeats: int) -> dict[str, Any]:
    """Weigh every arm, then time all of them in turns."""
    memory = {name: memory_of(name, bundle) for name in ARMS}
    times = time_interleaved({name: make_arm(name, bundle) for name in ARMS}, repeats)
    return {"machine": machine(), "repeats": repeats, "times": times, "peak_mb": memory}


def to_markdown(report: dict[str, Any]) -> str:
    """Format the times, and under them the memory."""
    memory = "\n".join(f"| {name} | {megabytes:.0f} |" for name, megabytes in report["peak_mb"].items())
    slower = np.median(report["times"]["skeleton space"]) / np.median(report["times"]["latent space"])
    return (
        f"# Skeleton space beside latent space and MDM\n\n{timing_table(report['times'], ARMS[2])}\n\n"
        f"A clip in skeleton space takes {slower:.2f} times one in latent space.\n\n"
        f"| | peak MB |\n|---|---|\n{memory}\n"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "bundle", "out", repeats=20, quick="two repeats")
    options = parser.parse_args(arguments)
    report = measure(options.bundle, 2 if options.quick else options.repeats)
    write_report(options.out, report, to_markdown(report))


if __name__ == "__main__":
    main()
