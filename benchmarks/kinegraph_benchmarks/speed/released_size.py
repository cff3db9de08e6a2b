"""Time the published networks and ours, each as its users run it: GraphMotion's Table C in one run.

    python -m kinegraph_benchmarks.speed.released_size --out released.json [--quick]

Weights are random: this is for latency, size and memory only. One call of every network is timed, all arms of one
network taking turns; a clip's seconds are the sum of its calls, as each model's configuration has them. Arms:

- eager torch: the network as it is released, conditions and time embedded at every step;
- plain export: the same call as torch exports it to ONNX, in float32, on onnxruntime with its defaults;
- our runtime, float32 and int8: the graphs that `import_graphmotion` and `import_mld` write.

GraphMotion is there twice: as published (9 layers of width 256, its Table 1) and as released (17 of width 1024).

A denoiser of the released GraphMotion has 237 M parameters. They are made, exported and timed one after another, which
takes 5 GB of memory at most; `--layers 5` makes smaller ones of the same width. `speed.released_bundle` times a whole
bundle of that size.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import onnxruntime
import torch
from torch import Tensor, nn

from kinegraph import MotionPipeline
from kinegraph.bench import GRAPH, machine
from kinegraph.bundle.contract import LEVELS, GraphContract, LevelSpec
from kinegraph.bundle.released_contract import released_level
from kinegraph.bundle.sessions import available_cpus, open_session, session_options
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.timing import Arm, time_interleaved, timing_table
from kinegraph_benchmarks.speed.clip_process import peak_memory
from kinegraph_export.graphs import Precision
from kinegraph_export.official.denoiser import OfficialDenoiser, OfficialDenoiserConfig
from kinegraph_export.official.graphs import export_graph, level_spec
from kinegraph_export.onnx_export import serialise, to_onnx
from kinegraph_training.models.transformer import EncoderLayer

TEXT_WIDTH, LATENT_WIDTH = 768, 256
RELEASED = OfficialDenoiserConfig(2, LATENT_WIDTH, 1024, 17, 16, 4096, TEXT_WIDTH, is_lifted=True)
PUBLISHED = OfficialDenoiserConfig(2, LATENT_WIDTH, 256, 9, 4, 1024, TEXT_WIDTH, is_lifted=False)
MLD = OfficialDenoiserConfig(1, LATENT_WIDTH, 256, 9, 4, 1024, TEXT_WIDTH, is_lifted=False)
TOKENS = (2, 4, 8)
PAPER_STEPS, CONFIGURED_STEPS = (15, 15, 20), (50, 50, 50)
"""Of GraphMotion's levels: the best 50 steps of the paper, and those of the released configuration."""
MDM_STEPS = (50, 1000)
MDM_FRAMES = 196
ROWS = 2
"""Unconditional and conditional."""
ARMS = ("eager torch", "plain export", "ours, fp32", "ours, int8")
PRECISIONS: tuple[Precision, ...] = ("fp32", "int8")


class MdmStep(nn.Module):
    """One call of a denoiser of MDM's size (Tevet et al., 2023): 8 encoder layers of width 512 over all frames."""

    def __init__(self) -> None:
        super().__init__()
        self.frames_in, self.frames_out = nn.Linear(263, 512), nn.Linear(512, 263)
        self.layers = nn.ModuleList(EncoderLayer(512, 4, 1024, 0.0) for _ in range(8))

    def forward(self, motion: Tensor) -> Tensor:
        """Predict (rows, frames, 263) from the same, with a token of time and text before it."""
        tokens = self.frames_in(motion)
        x = torch.cat([tokens[:, :1], tokens], dim=1)
        for layer in self.layers:
            x = layer(x, None)
        return self.frames_out(x[:, 1:])


@dataclass(frozen=True)
class Level:
    """One released denoiser, with what a run gives it."""

    name: str
    denoiser: OfficialDenoiser
    spec: LevelSpec
    coarse: LevelSpec | None
    nodes: Tensor
    latent: Tensor
    coarse_latent: Tensor | None

    @property
    def contracts(self) -> dict[str, GraphContract]:
        graphs = released_level(self.name, self.spec, TEXT_WIDTH, self.coarse)
        return {graph.name: graph for graph in graphs}

    @property
    def call(self) -> tuple[nn.Module, dict[str, Tensor]]:
        """One call as the released code makes it, and its inputs."""
        inputs = {"latent": self.latent, "timestep": torch.full((ROWS,), 501), "nodes": self.nodes}
        if self.coarse_latent is not None:
            inputs["coarse"] = self.coarse_latent
        return ReleasedCall(self.denoiser), inputs


class ReleasedCall(nn.Module):
    """A noise prediction as the released code makes it: conditions and time are embedded at every step."""

    def __init__(self, denoiser: OfficialDenoiser) -> None:
        super().__init__()
        self.denoiser = denoiser

    def forward(self, latent: Tensor, timestep: Tensor, nodes: Tensor, coarse: Tensor | None = None) -> Tensor:
        """Predict noise (rows, tokens, z) of a latent of that shape."""
        condition = self.denoiser.conditions(nodes, coarse)
        time = self.denoiser.time(timestep)
        return self.denoiser(latent, time, condition, torch.ones(ROWS, condition.shape[1]))


def eager_arm(module: nn.Module, inputs: dict[str, Tensor]) -> Arm:
    """Make the call of a module in eager torch."""

    def run() -> Tensor:
        with torch.no_grad():
            return module(*inputs.values())

    return run


def plain_arm(module: nn.Module, inputs: dict[str, Tensor], threads: int) -> tuple[Arm, int]:
    """Export a module as torch does, for fixed shapes; returns its call on onnxruntime, and the bytes of the graph."""
    model = to_onnx(module, tuple(inputs.values()), list(inputs), ["result"], tuple(None for _ in inputs))
    data = serialise(model)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    names = {entry.name for entry in session.get_inputs()}
    feeds = {name: value.numpy() for name, value in inputs.items() if name in names}
    return lambda: session.run(None, feeds), len(data)


def random_level(config: OfficialDenoiserConfig, name: str, kinds: int, coarse: LevelSpec | None) -> Level:
    """Make a denoiser with random weights.

    Args:
        config: of it.
        name: of the level.
        kinds: kinds of nodes that it sees.
        coarse: the coarser level; None at the coarsest.
    """
    torch.manual_seed(0)
    denoiser = OfficialDenoiser(config).requires_grad_(False).eval()
    for name_of, value in denoiser.named_parameters():
        if "in_proj" in name_of or name_of.endswith("pe"):
            nn.init.normal_(value, std=config.width**-0.5)  # left uninitialised by the module
    spec = level_spec(denoiser, kinds)
    slots = (1, 5, 13)[kinds - 1]
    coarse_latent = None if coarse is None else torch.randn(ROWS, coarse.tokens, coarse.latent_width)
    nodes, latent = torch.randn(ROWS, slots, config.text_width), torch.randn(ROWS, config.tokens, config.latent_width)
    return Level(name, denoiser, spec, coarse, nodes, latent, coarse_latent)


def session_arm(level: Level, precision: Precision, threads: int) -> tuple[Arm, int]:
    """Export a level's step graph, and make the call of one step; returns it and the bytes of the graph."""
    contract = level.contracts[f"denoiser_{level.name}"]
    data, _ = export_graph(level.denoiser, contract, precision)
    session = open_session(data, contract, session_options(threads))
    with torch.no_grad():
        condition = level.denoiser.conditions(level.nodes, level.coarse_latent).numpy()
        time = level.denoiser.time(torch.full((ROWS,), 501)).numpy()
    mask = np.ones(condition.shape[:2], dtype=np.float32)
    inputs = {"latent": level.latent.numpy(), "time": time, "condition": condition, "mask": mask}
    return lambda: session.run(["noise"], inputs), len(data)


def time_level(level: Level, threads: int, repeats: int) -> dict[str, Any]:
    """Time one step of a level by all arms in turn."""
    arms: dict[str, Arm] = {"eager torch": eager_arm(*level.call)}
    sizes: dict[str, int] = {}
    arms["plain export"], sizes["plain export"] = plain_arm(*level.call, threads)
    for precision in PRECISIONS:
        print(f"exporting {level.name} in {precision}", file=sys.stderr)
        arms[f"ours, {precision}"], sizes[precision] = session_arm(level, precision, threads)
    return {"times": time_interleaved(arms, repeats), "bytes": sizes}


def time_mdm(threads: int, repeats: int) -> dict[str, Any]:
    """Time one call of a denoiser of MDM's size: our runtime has no such graph."""
    torch.manual_seed(0)
    model, inputs = MdmStep().eval(), {"motion": torch.randn(ROWS, MDM_FRAMES, 263)}
    plain, size = plain_arm(model, inputs, threads)
    arms = {"eager torch": eager_arm(model, inputs), "plain export": plain}
    return {"times": time_interleaved(arms, repeats), "bytes": {"plain export": size}}


def time_ours(threads: int, repeats: int) -> dict[str, Any]:
    """Time whole clips of the default bundle, text encoder and decoder included."""
    pipe = MotionPipeline.load(threads=threads)
    arm = {"ours, default bundle": lambda: pipe.generate(GRAPH, seconds=6, seed=1)}
    return {"times": time_interleaved(arm, repeats)}


def clip_seconds(levels: Sequence[dict[str, Any]], steps: Sequence[int]) -> dict[str, float]:
    """Add up the denoiser calls of a clip by arm, from the minima of single calls."""
    arms = levels[0]["times"]
    return {
        arm: sum(count * min(level["times"][arm]) for level, count in zip(levels, steps, strict=True)) / 1000.0
        for arm in arms
    }


def table(result: dict[str, Any]) -> str:
    """Format seconds of a clip's denoising by model and arm, and the single calls below."""
    lines = [f"| a clip's denoising, seconds | steps | {' | '.join(ARMS)} |", "|---|---|" + "---|" * len(ARMS)]
    for name, entry in result["clips"].items():
        cells = [f"{entry['seconds'][arm]:.3f}" if arm in entry["seconds"] else "" for arm in ARMS]
        lines.append(f"| {name} | {entry['steps']} | {' | '.join(cells)} |")
    whole = min(result["networks"]["ours"]["times"]["ours, default bundle"]) / 1000.0
    lines += [f"| ours, a whole clip |{' |' * len(ARMS)} {whole:.3f} |", ""]
    for name, network in result["networks"].items():
        lines += [f"One call of {name}:", "", timing_table(network["times"]), ""]
        for precision, size in network.get("bytes", {}).items():
            lines.append(f"{precision}: {size / 1e6:.0f} MB")
    lines.append(f"Random weights; peak memory of this run {result['peak_mb']:.0f} MB")
    return "\n".join(lines) + "\n"


def measure(layers: int, width: int, threads: int, repeats: int) -> dict[str, Any]:
    """Measure all models; see the module.

    Args:
        layers: of GraphMotion's denoisers.
        width: of the same.
        threads: of torch and of every session.
        repeats: rounds of every arm.
    """
    torch.set_num_threads(threads)
    networks: dict[str, Any] = {}
    released = replace(RELEASED, layers=layers, width=width, feed_forward=4 * width)
    for model, config in (("as published", PUBLISHED), ("as released", released)):
        coarse: LevelSpec | None = None
        for kinds, (name, tokens) in enumerate(zip(LEVELS, TOKENS, strict=True), start=1):
            level = random_level(replace(config, tokens=tokens), name, kinds, coarse)
            networks[f"GraphMotion {model}, {name}"] = time_level(level, threads, repeats)
            coarse = level.spec
    mld = random_level(MLD, LEVELS[-1], 1, None)
    networks["MLD"] = time_level(mld, threads, repeats)
    networks["MDM"] = time_mdm(threads, repeats)
    networks["ours"] = time_ours(threads, repeats)
    calls = {
        model: [networks[f"GraphMotion {model}, {name}"] for name in LEVELS]
        for model in ("as published", "as released")
    }
    clips = {
        **{
            f"GraphMotion {model}": {"steps": "/".join(map(str, steps)), "seconds": clip_seconds(calls[model], steps)}
            for model, steps in (("as published", PAPER_STEPS), ("as released", PAPER_STEPS))
        },
        "GraphMotion as released, its configuration": {
            "steps": "50/50/50",
            "seconds": clip_seconds(calls["as released"], CONFIGURED_STEPS),
        },
        "MLD": {"steps": "50", "seconds": clip_seconds([networks["MLD"]], [50])},
        **{f"MDM ({n} steps)": {"steps": str(n), "seconds": clip_seconds([networks["MDM"]], [n])} for n in MDM_STEPS},
    }
    setting = {"layers": layers, "width": width, "threads": threads, "repeats": repeats}
    return {"machine": machine(), "setting": setting, "networks": networks, "clips": clips, "peak_mb": peak_memory()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "out", optional=("out",), repeats=15, quick="small networks, two repeats: to try the script")
    parser.add_argument("--layers", type=int, default=RELEASED.layers, help="of GraphMotion's denoisers")
    parser.add_argument("--width", type=int, default=RELEASED.width, help="of GraphMotion's denoisers")
    parser.add_argument("--threads", type=int, default=available_cpus())
    options = parser.parse_args(arguments)
    layers, width, repeats = (3, 64, 2) if options.quick else (options.layers, options.width, options.repeats)
    result = measure(layers, width, options.threads, repeats)
    write_report(options.out, result, table(result))


if __name__ == "__main__":
    main()
