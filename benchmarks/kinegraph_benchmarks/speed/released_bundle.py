"""Time a whole bundle of the released GraphMotion's size beside eager torch: disk, memory and seconds of a clip.

    python -m kinegraph_benchmarks.speed.released_bundle --work /tmp/released --out released_bundle.json [--quick]

Weights are random: three autoencoders of 18 M parameters, three denoisers of 237 M, CLIP ViT-L/14's text tower. The
bundles are those that `import_graphmotion` writes, in float32 and int8; eager torch does what the released code does:
CLIP run twice, conditions and time embedded at every step. Each arm is a process of its own, whose peak memory is its
own; the three make their clips in turn, so that a slow phase of the machine hits all of them.

Making the bundles takes 9 GB of memory and 6 GB of disk in --work, where they stay for the next run.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from tokenizers.pre_tokenizers import ByteLevel
from torch import Tensor, nn

from kinegraph.bench import machine
from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.sessions import available_cpus
from kinegraph.diffusion.sampling import NoiseSchedule, ddim_coefficients
from kinegraph.graph import ROLES
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.timing import Arm, time_interleaved, timing_table
from kinegraph_benchmarks.speed.clip_process import peak_memory
from kinegraph_benchmarks.speed.released_size import PAPER_STEPS, RELEASED, TOKENS
from kinegraph_export.clip_text_encoder import (
    BEGIN,
    END,
    ClipAssets,
    ClipConfig,
    ClipText,
    encode_empty,
    read_tokenizer,
    trace_clip,
)
from kinegraph_export.graphs import Precision
from kinegraph_export.official.bundle import Origin, read_parser, write_imported
from kinegraph_export.official.checkpoint import GraphMotionModels
from kinegraph_export.official.denoiser import OfficialDenoiser, OfficialDenoiserConfig
from kinegraph_export.official.graph_attention import ReleasedGraphAttention
from kinegraph_export.official.vae import OfficialVae, OfficialVaeConfig
from kinegraph_export.onnx_export import serialise
from kinegraph_export.text_encoder import quantise_text_encoder

SECONDS: Final = 6
FRAMES: Final = 120
SLOTS: Final = (1, 5, 13)
"""Nodes that a level sees."""
ARMS: Final = ("ours, int8", "ours, fp32", "eager torch")
PRECISIONS: Final[dict[str, Precision]] = {"ours, int8": "int8", "ours, fp32": "fp32"}


@dataclass(frozen=True)
class Sizes:
    """Sizes of all networks."""

    denoiser: OfficialDenoiserConfig
    vae: OfficialVaeConfig
    clip: ClipConfig

    @classmethod
    def released(cls) -> Sizes:
        """Return those of the released GraphMotion and of CLIP ViT-L/14."""
        vae = OfficialVaeConfig(263, 2, 256, 9, 4, 1024, 263)
        return cls(RELEASED, vae, ClipConfig(49408, 77, 768, 12, 12, 3072, 768, 1e-5, "quick_gelu"))

    @classmethod
    def quick(cls) -> Sizes:
        """Return small ones, to try the script."""
        denoiser = OfficialDenoiserConfig(2, 32, 64, 1, 4, 128, 64, is_lifted=True)
        vae = OfficialVaeConfig(263, 2, 32, 1, 4, 64, 263)
        return cls(denoiser, vae, ClipConfig(600, 77, 64, 2, 4, 128, 64, 1e-5, "quick_gelu"))


def random_models(sizes: Sizes) -> GraphMotionModels:
    """Make all networks of GraphMotion with random weights, the same for the same sizes."""
    torch.manual_seed(0)
    vaes, denoisers = {}, {}
    for level, tokens in zip(LEVELS, TOKENS, strict=True):
        vaes[level] = OfficialVae(_with_tokens(sizes.vae, tokens))
        denoisers[level] = OfficialDenoiser(_with_tokens(sizes.denoiser, tokens))
    attention = ReleasedGraphAttention(sizes.denoiser.text_width)
    for module in (*vaes.values(), *denoisers.values(), attention):
        _randomise(module)
    return GraphMotionModels(vaes, denoisers, attention)


def _with_tokens(config: Any, tokens: int) -> Any:
    return type(config)(**{**vars(config), "tokens": tokens})


def _randomise(module: nn.Module) -> nn.Module:
    """Fill the parameters that modules leave empty, and freeze all."""
    for name, value in module.requires_grad_(False).eval().named_parameters():
        if value.ndim > 1:
            nn.init.normal_(value, std=value.shape[-1] ** -0.5)
        elif not name.endswith(("norm1.weight", "norm2.weight", "norm3.weight", "norm.weight")):
            nn.init.zeros_(value)
    return module


def random_clip(sizes: Sizes, precision: Precision) -> ClipAssets:
    """Make a text tower with random weights, and a tokenizer of CLIP's form without merges."""
    torch.manual_seed(1)
    model = ClipText(sizes.clip)
    _randomise(model)
    graph = trace_clip(model)
    data = serialise(graph if precision == "fp32" else quantise_text_encoder(graph))
    letters = sorted(ByteLevel.alphabet())
    names = [*letters, *(f"{letter}</w>" for letter in letters)]
    names += [f"unused{number}</w>" for number in range(sizes.clip.vocabulary - len(names) - 2)]
    with tempfile.TemporaryDirectory() as folder:
        words = {name: number for number, name in enumerate([*names, BEGIN, END])}
        (Path(folder) / "vocab.json").write_text(json.dumps(words), encoding="utf-8")
        (Path(folder) / "merges.txt").write_text("#version: 0.2\n", encoding="utf-8")
        tokenizer = read_tokenizer(Path(folder), sizes.clip.vocabulary)
    return ClipAssets(data, tokenizer, encode_empty(model), sizes.clip.positions, {})


def make_bundle(out: Path, sizes: Sizes, precision: Precision) -> None:
    """Write a bundle with random weights, unless one is there."""
    if (out / "manifest.json").is_file():
        return
    origin = Origin("released-size", "random weights of GraphMotion's released size", "Apache-2.0", Path("random"))
    statistics = (np.zeros(263, dtype=np.float32), np.full(263, 0.05, dtype=np.float32))
    clip, parser = random_clip(sizes, precision), read_parser(None)
    write_imported(out, origin, random_models(sizes), "graphmotion-released", clip, statistics, parser, precision)


def make_in_a_process(out: Path, sizes: Sizes, precision: Precision) -> None:
    """Write a bundle as `make_bundle` does, in a process whose memory goes back to the system."""
    maker = get_context("spawn").Process(target=make_bundle, args=(out, sizes, precision))
    maker.start()
    maker.join()
    if maker.exitcode != 0:
        raise RuntimeError(f"making the bundle in {precision} failed with status {maker.exitcode}")


class EagerClip:
    """The released pipeline in eager torch: CLIP twice, graph attention, three guided levels, one decoder."""

    def __init__(self, sizes: Sizes, steps: Sequence[int]) -> None:
        self.models, self.steps = random_models(sizes), steps
        torch.manual_seed(1)
        self.clip = _randomise(ClipText(sizes.clip))
        end = sizes.clip.vocabulary - 1
        self.ids = torch.full((2, sizes.clip.positions), end)
        self.ids[:, 0] = end - 1
        self.ids[1, 1:9] = torch.arange(8)
        self.schedule = NoiseSchedule(1000)

    @torch.no_grad()
    def __call__(self) -> Tensor:
        """Make the features of one clip, (1, frames, 263)."""
        mask = torch.ones_like(self.ids)
        hidden, pooled = self.clip(self.ids, mask)[0], self.clip(self.ids, mask)[1]
        nodes = torch.cat([pooled.reshape(2, 1, -1), hidden[:, 1 : SLOTS[-1]]], dim=1)
        edges = torch.ones(2, SLOTS[-1], SLOTS[-1])
        nodes = self.models.graph_attention(nodes, edges, torch.zeros(2, len(ROLES), SLOTS[-1], SLOTS[-1]))
        latent: Tensor | None = None
        for slots, level, steps in zip(SLOTS, LEVELS, self.steps, strict=True):
            latent = self.sample(self.models.denoisers[level], nodes[:, :slots], latent, steps)
        assert latent is not None
        return self.models.vaes[LEVELS[-1]].decode(latent[1:], torch.ones(1, FRAMES))

    def sample(self, denoiser: OfficialDenoiser, nodes: Tensor, coarse: Tensor | None, steps: int) -> Tensor:
        """Sample a level by guided DDIM: latents (2, tokens, z), the unconditional half first."""
        ddim = ddim_coefficients(self.schedule, steps)
        latent = torch.randn(1, denoiser.config.tokens, denoiser.config.latent_width).expand(2, -1, -1)
        for index, timestep in enumerate(ddim.timesteps):
            condition = denoiser.conditions(nodes, coarse)
            time = denoiser.time(torch.full((2,), int(timestep)))
            noise = denoiser(latent, time, condition, torch.ones(2, condition.shape[1]))
            guided = noise[:1] + 7.5 * (noise[1:] - noise[:1])
            latent = (float(ddim.keep[index]) * latent + float(ddim.move[index]) * guided).expand(2, -1, -1)
        return latent


def serve_eager(quick: bool, steps: tuple[int, ...], threads: int, pipe: Connection) -> None:
    """Make a clip in eager torch whenever asked, in a process of its own; answers with its peak memory in MB."""
    torch.set_num_threads(threads)
    make = EagerClip(Sizes.quick() if quick else Sizes.released(), steps)
    with suppress(EOFError):  # the other end is closed when all is measured
        while pipe.recv() == "clip":
            make()
            pipe.send(peak_memory())


def start_eager(quick: bool, steps: tuple[int, ...], threads: int) -> Callable[[], float]:
    """Start the process of eager torch; returns the call that makes a clip and tells its peak memory."""
    context = get_context("spawn")
    ours, other = context.Pipe()
    context.Process(target=serve_eager, args=(quick, steps, threads, other), daemon=True).start()

    def ask() -> float:
        ours.send("clip")
        return float(ours.recv())

    return ask


def start_bundle(folder: Path, steps: tuple[int, ...], threads: int, stack: ExitStack) -> Callable[[], float]:
    """Start a process of a bundle, without torch, that ends with `stack`; returns its call as `start_eager` does."""
    words = ["--bundle", str(folder), "--steps", ",".join(map(str, steps)), "--seconds", str(SECONDS)]
    command = [sys.executable, "-m", "kinegraph_benchmarks.speed.clip_process", *words, "--threads", str(threads)]
    # What this process can import the other can too: benchmarks are not installed.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = stack.enter_context(
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
    )
    assert process.stdin is not None and process.stdout is not None
    stack.callback(process.stdin.close)
    asked, answers = process.stdin, process.stdout

    def ask() -> float:
        asked.write("clip\n")
        asked.flush()
        return float(answers.readline())

    return ask


def measure(work: Path, *, quick: bool, steps: tuple[int, ...], threads: int, repeats: int) -> dict[str, Any]:
    """Make the bundles, then time all arms in turn; see the module."""
    sizes = Sizes.quick() if quick else Sizes.released()
    work.mkdir(parents=True, exist_ok=True)
    make = make_bundle if quick else make_in_a_process
    for precision in PRECISIONS.values():
        make(work / precision, sizes, precision)
    memory: dict[str, float] = {}
    with ExitStack() as stack:
        calls = {arm: start_bundle(work / name, steps, threads, stack) for arm, name in PRECISIONS.items()}
        calls["eager torch"] = start_eager(quick, steps, threads)
        arms: dict[str, Arm] = {arm: lambda arm=arm: memory.update({arm: calls[arm]()}) for arm in ARMS}
        times = time_interleaved(arms, repeats, warm_up=1)
    disk = {
        arm: sum(path.stat().st_size for path in (work / precision).iterdir()) for arm, precision in PRECISIONS.items()
    }
    setting = {"quick": quick, "steps": list(steps), "seconds": SECONDS, "threads": threads, "repeats": repeats}
    return {"machine": machine(), "setting": setting, "times": times, "bytes": disk, "peak_mb": memory}


def table(result: dict[str, Any]) -> str:
    """Format seconds, disk and memory by arm as Markdown."""
    steps = "/".join(map(str, result["setting"]["steps"]))
    small = " (small ones: --quick)" if result["setting"]["quick"] else ""
    lines = [
        f"A clip of {SECONDS} s at {steps} steps, random weights of the released size{small}; each arm is a process.",
        "",
        "| | seconds a clip | peak memory, MB | on disk, MB |",
        "|---|---|---|---|",
    ]
    for arm in ARMS:
        disk = f"{result['bytes'][arm] / 1e6:.0f}" if arm in result["bytes"] else "-"
        lines.append(f"| {arm} | {min(result['times'][arm]) / 1000:.2f} | {result['peak_mb'][arm]:.0f} | {disk} |")
    return "\n".join([*lines, "", timing_table(result["times"], "eager torch")]) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "work", "out", optional=("out",), repeats=5, quick="small networks, two repeats")
    parser.add_argument("--steps", type=lambda text: tuple(map(int, text.split(","))), default=PAPER_STEPS)
    parser.add_argument("--threads", type=int, default=available_cpus())
    options = parser.parse_args(arguments)
    steps, repeats = ((2, 2, 2), 2) if options.quick else (options.steps, options.repeats)
    result = measure(options.work, quick=options.quick, steps=steps, threads=options.threads, repeats=repeats)
    write_report(options.out, result, table(result))


if __name__ == "__main__":
    main()
