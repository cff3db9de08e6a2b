"""The same task at the published size, with random weights: GraphMotion's denoisers as published (`concat`), ours
(`cross`), in torch and as ONNX. For latency only: nothing here has learnt anything.
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

from kinegraph.bundle.contract import LEVELS, NODE_KINDS, NULL_KIND, GraphContract, LevelSpec
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
from kinegraph_export.onnx_export import round_weights, serialised, to_onnx
from kinegraph_training.config import read_preset
from kinegraph_training.models.denoiser import LatentShape
from kinegraph_training.models.hierarchy import Hierarchy

GUIDANCE_ROWS = 2
FRAMES_PER_TOKEN = 4
FloatArray = np.ndarray
Run = Callable[[dict[str, FloatArray]], FloatArray]
"""One call of a published level: its inputs by name -> noise (2, C, z)."""


@dataclass(frozen=True)
class Task:
    """What all arms do: one sample, with guidance, at the bundle's default steps."""

    manifest: Manifest
    options: GenerateOptions
    encoded: Conditions
    """(1, N) nodes with random features."""

    @property
    def plans(self) -> list[LevelPlan]:
        """Levels of the paper."""
        steps = self.options.steps
        return [LevelPlan(n, s.tokens, s.latent_width, steps[n]) for n, s in self.manifest.levels.items()]

    @property
    def contracts(self) -> dict[str, GraphContract]:
        """Of our graphs."""
        return self.manifest.contracts


def paper_task(graph: SemanticGraph, options: GenerateOptions, copies: int = 1) -> Task:
    """The default bundle's manifest with the paper's sizes."""
    preset = read_preset("paper")
    config = preset.denoiser
    shapes = latent_shapes()
    levels = {
        name: LevelSpec(
            shape.tokens, shape.width, config.width, config.heads, config.layers, NODE_KINDS[: config.kinds_seen(name)]
        )
        for name, shape in shapes.items()
    }
    _, _, kind, order, path = graph_structure(graph)
    width = config.text_width
    arrays = SimpleNamespace(kind=kind, order=order, path_weight=path)
    nodes = np.random.default_rng(0).standard_normal((copies, len(kind), width)).astype(np.float32)
    return Task(replace(read_bundle(None).manifest, levels=levels), options, make_conditions([arrays] * copies, nodes))


def latent_shapes() -> dict[str, LatentShape]:
    """Of the preset `paper`."""
    vaes = read_preset("paper").vae
    return {level: LatentShape(vaes[level].tokens, vaes[level].latent_width) for level in LEVELS}


def hierarchy(kind: str) -> Hierarchy:
    """Random weights as a bundle would hold them, evaluation mode."""
    torch.manual_seed(0)
    model = Hierarchy(replace(read_preset("paper").denoiser, kind=kind), latent_shapes()).eval()
    round_weights(model)
    return model


class WholeLevel(nn.Module):
    """One level as it is published: conditions, time and noise prediction in every call."""

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
        context = self.denoiser.context(nodes, kind, order, coarse)
        return self.denoiser.step(latent, self.denoiser.clock(timestep, frames), context, bias[:, None, None, :])


def level_inputs(task: Task, level: str, coarse: FloatArray | None) -> dict[str, FloatArray]:
    """Both rows of guidance, the unconditional one first; all that is constant over the steps."""
    seen = task.encoded
    kind = np.concatenate([np.full_like(seen.kind, NULL_KIND), seen.kind])
    bias = np.concatenate([np.full_like(seen.bias, -1e4), seen.bias])
    bias[0, 0] = 0.0
    found = {
        "frames": np.full(GUIDANCE_ROWS, task.options.frames, dtype=np.int64),
        "nodes": np.concatenate([np.zeros_like(seen.nodes), seen.nodes]),
        "kind": kind,
        "order": np.concatenate([np.zeros_like(seen.order), seen.order]),
        "bias": bias,
    }
    if coarse is not None:
        found["coarse"] = np.concatenate([coarse, coarse])
        extra = np.zeros((GUIDANCE_ROWS, coarse.shape[1]), dtype=np.float32)
        found["bias"] = np.concatenate([bias, extra], axis=1)
    return found


def sample(task: Task, levels: dict[str, Run]) -> FloatArray:
    """The published loop around whole levels; both rows in one call."""
    noises = initial_noise(0, task.plans)
    coarse: FloatArray | None = None
    for plan, noise in zip(task.plans, noises, strict=True):
        times = ddim_coefficients(task.manifest.schedule.noise, plan.steps)
        constant, latent = level_inputs(task, plan.name, coarse), noise[None]
        for step, time in enumerate(times.timesteps):
            twice = np.concatenate([latent, latent])
            both = levels[plan.name](
                {"latent": twice, "timestep": np.full(GUIDANCE_ROWS, time, dtype=np.int64), **constant}
            )
            latent = ddim_step(latent, guide(both[:1], both[1:], task.options.guidance[plan.name]), times, step)
        coarse = latent
    assert coarse is not None
    return coarse


def in_torch(model: Hierarchy) -> dict[str, Run]:
    """Eager."""

    def run(level: nn.Module, inputs: dict[str, FloatArray]) -> FloatArray:
        with torch.inference_mode():
            found: FloatArray = level(**{name: torch.from_numpy(value) for name, value in inputs.items()}).numpy()
        return found

    levels = {name: WholeLevel(part) for name, part in model.levels.items()}
    return {name: partial(run, level) for name, level in levels.items()}


def plainly_exported(model: Hierarchy, task: Task, threads: int) -> dict[str, Run]:
    """`torch.onnx.export` of whole levels, as anybody would do it."""
    found: dict[str, Run] = {}
    coarse: FloatArray | None = None
    for plan in task.plans:
        inputs = level_inputs(task, plan.name, coarse)
        latent = np.zeros((GUIDANCE_ROWS, plan.tokens, plan.latent_width), dtype=np.float32)
        feeds = {"latent": latent, "timestep": np.ones(GUIDANCE_ROWS, dtype=np.int64), **inputs}
        order = ["latent", "timestep", "frames", "nodes", "kind", "order", "bias"]
        order += [] if coarse is None else ["coarse"]
        example = tuple(torch.from_numpy(feeds[name]) for name in order)
        graph = to_onnx(WholeLevel(model.levels[plan.name]), example, order, ["noise"], tuple({} for _ in order))
        session = onnxruntime.InferenceSession(serialised(graph), session_options(threads))
        found[plan.name] = lambda inputs, session=session: session.run(["noise"], inputs)[0]
        coarse = latent[:1]
    return found


def exported(model: Hierarchy, task: Task, precision: Precision) -> dict[str, bytes]:
    """Our graphs by name."""
    found: dict[str, bytes] = {}
    for level, denoiser in model.levels.items():
        context = MotionContextGraph if level == LEVELS[0] else ContextGraph
        modules = {"context": context(denoiser.context), "clock": ModulationGraph(denoiser.clock)}
        for part, module in {**modules, "step": DenoiserGraph(denoiser.step)}.items():
            name = f"{part}_{level}"
            found[name], _ = export_graph(module.eval(), task.contracts[name], FRAMES_PER_TOKEN, precision)
    return found


def ours(graphs: dict[str, bytes], task: Task, threads: int) -> LatentSampler:
    """The runtime's own sampler around exported graphs."""
    sessions: dict[str, dict[str, Any]] = {"context": {}, "clock": {}, "step": {}}
    for name, data in graphs.items():
        part, _, level = name.partition("_")
        sessions[part][level] = open_session(data, task.contracts[name], session_options(threads))
    return LatentSampler(SimpleNamespace(**sessions), task.manifest)  # type: ignore[arg-type]
