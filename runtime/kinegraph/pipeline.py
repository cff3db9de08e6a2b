"""From a sentence to a clip; the stages in order, as in GraphMotion's figure 2.

text -> graph -> node features -> graph attention -> motion -> action -> specific latent -> features -> joints
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from kinegraph.bundle import read_bundle
from kinegraph.conditions import (
    Conditions,
    GraphArrays,
    conditions,
    for_level,
    graph_arrays,
    null_like,
    padded,
    stacked,
)
from kinegraph.contract import LEVELS
from kinegraph.diffusion.ddim import DdimCoefficients
from kinegraph.diffusion.guidance import guided
from kinegraph.diffusion.sampler import LevelPlan, OnStep, Predict, coarse_to_fine, initial_noise
from kinegraph.errors import BundleError, NonFiniteError
from kinegraph.graph import SemanticGraph
from kinegraph.manifest import Manifest
from kinegraph.motion.clip import Clip
from kinegraph.motion.features import joints_from_features
from kinegraph.motion.humanml3d import joints_from_humanml3d
from kinegraph.options import GenerateOptions, Guidance, Steps, generate_options
from kinegraph.sessions import Sessions, open_sessions
from kinegraph.text.parser import GraphParser, check_caption
from kinegraph.text.tokens import CaptionTokenizer

FloatArray = NDArray[np.float32]

_TO_JOINTS = {"joints-137": joints_from_features, "humanml3d-263": joints_from_humanml3d}


class MotionPipeline:
    """A loaded bundle. Any number of threads may share it; each call keeps its state to itself."""

    def __init__(
        self,
        manifest: Manifest,
        sessions: Sessions,
        tokenizer: CaptionTokenizer,
        tables: Mapping[str, FloatArray],
        parser: LazyParser,
    ) -> None:
        self.manifest = manifest
        """What the bundle is: licence, limits, defaults, measured quality."""
        self._sessions = sessions
        self._tokenizer = tokenizer
        self._tables = tables
        self._parser = parser

    @classmethod
    def load(
        cls,
        path: str | Path | None = None,
        *,
        threads: int | None = None,
        session_options: onnxruntime.SessionOptions | None = None,
    ) -> MotionPipeline:
        """Read a bundle, check every byte, and make its sessions.

        Args:
            path: folder of a bundle; None is the one that comes with the package.
            threads: of every session; None chooses (`sessions.open_sessions`).
            session_options: the host's own onnxruntime options, instead of `threads`.

        Raises:
            BundleError: missing, altered or unusable; see its subclasses.
            InvalidInputError: `threads` is out of range.
        """
        bundle = read_bundle(None if path is None else Path(path))
        sessions = open_sessions(bundle, threads=threads, options=session_options)
        tokenizer = CaptionTokenizer(bundle.files["tokenizer.json"])
        return cls(bundle.manifest, sessions, tokenizer, bundle.tables, LazyParser(bundle.files.get("parser.bin")))

    def parse(self, text: str) -> SemanticGraph:
        """The semantic graph of a sentence: look at it, edit it, hand it back to `generate`.

        Raises:
            InvalidInputError: blank, too long, or without a letter or digit.
            MissingExtraError: spaCy is not installed (`pip install "kinegraph[text]"`).
            BundleError: the bundle carries no parser.
        """
        check_caption(text)
        return self._parser().parse(text)

    def generate(
        self,
        text: str | SemanticGraph,
        *,
        seconds: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        on_step: OnStep | None = None,
    ) -> Clip:
        """A clip for a sentence or a graph. The same arguments give the same clip, bit for bit.

        Args:
            text: a sentence, or its graph.
            seconds: length; None is the bundle's default.
            seed: of the noise, 0 to 2**63 - 1; None draws one, to be found in the clip.
            steps: diffusion steps, one number or one per level.
            guidance: how strictly the text is followed, one number or one per level.
            on_step: called after every step with a `StepInfo`; returning False stops with `Cancelled`.

        Raises:
            InvalidInputError: text or an option is outside what the model takes; nothing has been run.
            Cancelled: `on_step` returned False.
            NonFiniteError: a model produced NaN or infinity.
        """
        options = generate_options(self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance)
        graph = text if isinstance(text, SemanticGraph) else self.parse(text)
        encoded = self._encode([self._arrays(graph)])
        latent = self._sample(encoded, [options], on_step)
        joints = self._decode(latent, [options])[0]
        return Clip(
            joints=joints,
            fps=self.manifest.fps,
            seed=options.seed,
            text=graph.caption,
            bundle=f"{self.manifest.name} {self.manifest.version}",
        )

    def _arrays(self, graph: SemanticGraph) -> GraphArrays:
        tokens = self._tokenizer.encode(graph.caption)
        feeds = {"input_ids": tokens.ids[None], "attention_mask": tokens.mask[None]}
        hidden, pooled = self._sessions.text_encoder.run(["hidden", "pooled"], feeds)
        return graph_arrays(graph, tokens, hidden[0], pooled[0])

    def _encode(self, arrays: Sequence[GraphArrays]) -> Conditions:
        """Graph attention over a batch of graphs."""
        (nodes,) = self._sessions.graph_encoder.run(["nodes_out"], padded(arrays))
        return conditions(arrays, _finite(nodes, "the graph encoder"))

    def _sample(self, encoded: Conditions, options: Sequence[GenerateOptions], on_step: OnStep | None) -> FloatArray:
        """Latents of the finest level, (B, C, z); all samples of a batch share steps and guidance."""
        first = options[0]
        plans = [
            LevelPlan(name, spec.tokens, spec.latent_width, first.steps[name])
            for name, spec in ((name, self.manifest.levels[name]) for name in LEVELS)
        ]
        per_sample = [initial_noise(each.seed, plans) for each in options]
        noises = [np.stack(level) for level in zip(*per_sample, strict=True)]
        frames = np.array([each.frames for each in options])

        def predictor_for(number: int, times: DdimCoefficients, coarse: FloatArray | None) -> Predict:
            name = LEVELS[number]
            return self._predictor(name, encoded, coarse, frames, times, first.guidance[name])

        return coarse_to_fine(plans, noises, predictor_for, self.manifest.schedule.noise, on_step)[-1]

    def _predictor(
        self,
        name: str,
        encoded: Conditions,
        coarse: FloatArray | None,
        frames: NDArray[np.int64],
        times: DdimCoefficients,
        scale: float,
    ) -> Predict:
        """Guided noise prediction of one level. Everything that is constant over its steps is computed here, once.

        Rows are the unconditional predictions of all samples, then the conditional ones.
        """
        spec = self.manifest.levels[name]
        seen = for_level(encoded, spec.nodes)
        rows = stacked(null_like(seen), seen)
        keys_values, bias = self._context(name, rows, coarse)
        count = len(rows.kind)
        temb = (
            self._tables[f"time_{name}"][times.timesteps][:, None, None, :]
            + self._tables[f"length_{name}"][np.tile(frames, 2)][None, :, None, :]
        )
        constant = {
            **keys_values,
            "src": np.arange(count, dtype=np.int64),
            "combine": np.eye(count, dtype=np.float32),
            "bias": bias,
        }
        session = self._sessions.step[name]

        def predict(latent: FloatArray, step: int) -> FloatArray:
            feeds = {"latent": np.concatenate([latent, latent]), "temb": temb[step], **constant}
            (noise,) = session.run(["noise"], feeds)
            unconditional, conditional = np.split(noise, 2)
            return guided(unconditional, conditional, scale)

        return predict

    def _context(
        self, name: str, rows: Conditions, coarse: FloatArray | None
    ) -> tuple[dict[str, FloatArray], FloatArray]:
        """Keys and values of every layer, and the attention bias (A, 1, C, S)."""
        session = self._sessions.context[name]
        feeds = {"nodes": rows.nodes, "kind": rows.kind, "order": rows.order}
        bias = rows.bias
        if coarse is not None:
            shared = np.concatenate([coarse] * (len(rows.kind) // len(coarse)))
            feeds["coarse"] = shared
            bias = np.concatenate([bias, np.zeros(shared.shape[:2], dtype=np.float32)], axis=1)
        names = [output.name for output in session.get_outputs()]
        keys_values = dict(zip(names, session.run(names, feeds), strict=True))
        spread = np.repeat(bias[:, None, None, :], self.manifest.levels[name].tokens, axis=2)
        return keys_values, spread

    def _decode(self, latent: FloatArray, options: Sequence[GenerateOptions]) -> list[FloatArray]:
        """Joints (frames, 22, 3) of every sample."""
        manifest = self.manifest
        group = manifest.frames.per_token
        longest = -(-max(each.frames for each in options) // group) * group
        frame_mask = np.zeros((len(options), longest), dtype=np.float32)
        for row, each in enumerate(options):
            frame_mask[row, : each.frames] = 1.0
        feeds = {"latent": latent, "frame_mask": frame_mask}
        (features,) = self._sessions.decoder.run(["features"], feeds)
        mean, std = (np.array(part, dtype=np.float32) for part in (manifest.features.mean, manifest.features.std))
        raw = _finite(features, "the decoder") * std + mean
        to_joints = _TO_JOINTS[manifest.features.layout]
        return [to_joints(rows[: each.frames]) for rows, each in zip(raw, options, strict=True)]


class LazyParser:
    """Makes the parser when the first sentence comes: whoever brings graphs never pays for spaCy."""

    def __init__(self, data: bytes | None) -> None:
        self._data = data
        self._lock = threading.Lock()
        self._parser: GraphParser | None = None

    def __call__(self) -> GraphParser:
        with self._lock:
            if self._parser is None:
                if self._data is None:
                    raise BundleError("this bundle carries no parser; pass a SemanticGraph instead of a sentence")
                self._parser = GraphParser(self._data)
                self._data = None
            return self._parser


def _finite(values: FloatArray, stage: str) -> FloatArray:
    if not np.isfinite(values).all():
        raise NonFiniteError(f"{stage} produced NaN or infinity; the bundle's weights are broken")
    return values
