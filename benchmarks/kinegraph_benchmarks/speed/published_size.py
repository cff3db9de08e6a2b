"""Build GraphMotion's denoisers as published (`concat`) and ours (`cross`) at the published size, with the same task.

Both exist in torch and as ONNX. Their weights are random: they are for latency only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import onnxruntime
import torch
from torch import Tensor, nn

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import LEVELS, NULL_KIND, GraphContract, LevelSpec, contracts
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.sessions import open_session, session_options
from kinegraph.conditioning import Conditions, graph_structure, make_conditions
from kinegraph.denoising import LatentSampler
from kinegraph.diffusion.sampling import LevelPlan, ddim_coefficients, ddim_step, guide, initial_noise
from kinegraph.graph import SemanticGraph
from kinegraph.options import GenerateOptions
from kinegraph_export.graphs import Precision, export_graph
from kinegraph_export.modules import ContextGraph, DenoiserGraph, ModulationGraph, MotionContextGraph
from kinegraph_export.onnx_export import round_weights, serialise, to_onnx
from kinegraph_training.config import read_preset
from kinegraph_training.models.denoiser import LatentShape
from kinegraph_training.models.hierarchy import Hierarchy

GUIDANCE_ROWS = 2
"""Unconditional and conditional."""
FRAMES_PER_TOKEN = 4
LevelRun = Callable[[dict[str, FloatArray]], FloatArray]
"""One call of a published level: inputs by name -> predicted noise (2, C, z)."""


@dataclass(frozen=True)
class SamplingTask:
    """The task of all arms: one sample, with guidance."""

    manifest: Manifest
    options: GenerateOptions
    conditions: Conditions
    """(copies, N) nodes with random features."""

    @property
    def plans(self) -> list[LevelPlan]:
        """Levels of the paper with the steps of the options."""
        steps = self.options.steps
        return [
            LevelPlan(name, level.tokens, level.latent_width, steps[name])
            for name, level in self.manifest.levels.items()
        ]

    @property
    def contracts(self) -> dict[str, GraphContract]:
        """Contracts of our graphs, by name."""
        return contracts(self.manifest.levels, self.manifest.text.width, len(self.manifest.features.mean))


def paper_task(graph: SemanticGraph, options: GenerateOptions, copies: int = 1) -> SamplingTask:
    """Make a task with the default bundle's manifest at the paper's sizes.

    Args:
        graph: gives the number and the kinds of nodes.
        options: frames, steps and guidance.
        copies: graphs of the task, as many as a composition has concepts and texts.
    """
    preset = read_preset("paper")
    config = preset.denoiser
    shapes = latent_shapes()
    levels = {
        name: LevelSpec(shape.tokens, shape.width, config.width, config.heads, config.layers, config.kinds_seen(name))
        for name, shape in shapes.items()
    }
    _, _, kind, order, path = graph_structure(graph)
    width = config.text_width
    arrays = SimpleNamespace(kind=kind, order=order, path_weight=path)
    nodes = np.random.default_rng(0).standard_normal((copies, len(kind), width)).astype(np.float32)
    return SamplingTask(
        replace(read_bundle(None).manifest, levels=levels), options, make_conditions([arrays] * copies, nodes)
    )


def latent_shapes() -> dict[str, LatentShape]:
    """Read the latent shapes of preset `paper`."""
    vaes = read_preset("paper").vae
    return {level: LatentShape(vaes[level].tokens, vaes[level].latent_width) for level in LEVELS}


def random_hierarchy(kind: str) -> Hierarchy:
    """Make denoisers with random weights, rounded as a bundle would hold them, in evaluation mode."""
    torch.manual_seed(0)
    model = Hierarchy(replace(read_preset("paper").denoiser, kind=kind), latent_shapes()).eval()
    round_weights(model)
    return model


class WholeLevel(nn.Module):
    """One level as it is published: every call encodes conditions and time and predicts noise."""

    def __init__(self, denoiser: nn.Module) -> None:
        super().__init__()
        self.denoiser = denoiser

    def forward(
        self,
        latent: Tensor,
        timestep: Tensor,
        frames: Tensor,
        nodes: Tensor,
        kind: Tensor,
        order: Tensor,
        bias: Tensor,
        coarse: Tensor | None = None,
    ) -> Tensor:
        context = self.denoiser.context(nodes, kind, order, bias, coarse)
        return self.denoiser.step(latent, self.denoiser.clock(timestep, frames), context, bias[:, None, None, :])


def level_inputs(task: SamplingTask, level: str, coarse: FloatArray | None) -> dict[str, FloatArray]:
    """Make the inputs of a level that are constant over its steps: rows of guidance, the unconditional one first."""
    conditions = task.conditions
    kind = np.concatenate([np.full_like(conditions.kind, NULL_KIND), conditions.kind])
    bias = np.concatenate([np.full_like(conditions.bias, -1e4), conditions.bias])
    bias[0, 0] = 0.0
    inputs = {
        "frames": np.full(GUIDANCE_ROWS, task.options.frames, dtype=np.int64),
        "nodes": np.concatenate([np.zeros_like(conditions.nodes), conditions.nodes]),
        "kind": kind,
        "order": np.concatenate([np.zeros_like(conditions.order), conditions.order]),
        "bias": bias,
    }
    if coarse is not None:
        inputs["coarse"] = np.concatenate([coarse, coarse])
        extra = np.zeros((GUIDANCE_ROWS, coarse.shape[1]), dtype=np.float32)
        inputs["bias"] = np.concatenate([bias, extra], axis=1)
    return inputs


def sample(task: SamplingTask, levels: dict[str, LevelRun]) -> FloatArray:
    """Sample with the published loop around whole levels, both rows of guidance in one call; final latents."""
    noises = initial_noise(0, task.plans)
    coarse: FloatArray | None = None
    for plan, noise in zip(task.plans, noises, strict=True):
        times = ddim_coefficients(task.manifest.schedule.noise, plan.steps)
        constant, latent = level_inputs(task, plan.name, coarse), noise[None]
        for step, time in enumerate(times.timesteps):
            rows = np.concatenate([latent, latent])
            noise_pred = levels[plan.name](
                {"latent": rows, "timestep": np.full(GUIDANCE_ROWS, time, dtype=np.int64), **constant}
            )
            noise_pred = guide(noise_pred[:1], noise_pred[1:], task.options.guidance[plan.name])
            latent = ddim_step(latent, noise_pred, times, step)
        coarse = latent
    assert coarse is not None
    return coarse


def torch_levels(model: Hierarchy) -> dict[str, LevelRun]:
    """Wrap the levels of a model in eager torch."""

    def run(level: nn.Module, inputs: dict[str, FloatArray]) -> FloatArray:
        with torch.inference_mode():
            noise: FloatArray = level(**{name: torch.from_numpy(value) for name, value in inputs.items()}).numpy()
        return noise

    levels = {name: WholeLevel(part) for name, part in model.levels.items()}
    return {name: partial(run, level) for name, level in levels.items()}


def plain_onnx_levels(model: Hierarchy, task: SamplingTask, threads: int) -> dict[str, LevelRun]:
    """Export whole levels with `torch.onnx.export` alone, and wrap their sessions."""
    runs: dict[str, LevelRun] = {}
    coarse: FloatArray | None = None
    for plan in task.plans:
        inputs = level_inputs(task, plan.name, coarse)
        latent = np.zeros((GUIDANCE_ROWS, plan.tokens, plan.latent_width), dtype=np.float32)
        feeds = {"latent": latent, "timestep": np.ones(GUIDANCE_ROWS, dtype=np.int64), **inputs}
        order = ["latent", "timestep", "frames", "nodes", "kind", "order", "bias"]
        order += [] if coarse is None else ["coarse"]
        example = tuple(torch.from_numpy(feeds[name]) for name in order)
        graph = to_onnx(WholeLevel(model.levels[plan.name]), example, order, ["noise"], tuple({} for _ in order))
        session = onnxruntime.InferenceSession(serialise(graph), session_options(threads))
        runs[plan.name] = lambda inputs, session=session: session.run(["noise"], inputs)[0]
        coarse = latent[:1]
    return runs


def export_graphs(model: Hierarchy, task: SamplingTask, precision: Precision) -> dict[str, bytes]:
    """Export our graphs of all levels, by name."""
    graphs: dict[str, bytes] = {}
    for level, denoiser in model.levels.items():
        context = MotionContextGraph if level == LEVELS[0] else ContextGraph
        modules = {"context": context(denoiser.context), "modulation": ModulationGraph(denoiser.clock)}
        for part, module in {**modules, "denoiser": DenoiserGraph(denoiser.step)}.items():
            name = f"{part}_{level}"
            graphs[name], _ = export_graph(module.eval(), task.contracts[name], FRAMES_PER_TOKEN, precision)
    return graphs


def make_sampler(graphs: dict[str, bytes], task: SamplingTask, threads: int) -> LatentSampler:
    """Make the runtime's own sampler around exported graphs."""
    sessions: dict[str, dict[str, Any]] = {"context": {}, "modulation": {}, "denoiser": {}}
    for name, data in graphs.items():
        part, _, level = name.partition("_")
        sessions[part][level] = open_session(data, task.contracts[name], session_options(threads))
    return LatentSampler(SimpleNamespace(**sessions), task.manifest)  # type: ignore[arg-type]
