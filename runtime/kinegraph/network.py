"""The denoiser of one level, ready for the steps of one sample: what is constant over the steps is computed once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from kinegraph.conditions import Conditions
from kinegraph.diffusion.composition import Wiring

FloatArray = NDArray[np.float32]

RowNetwork = Callable[[FloatArray, int], FloatArray]
"""(latents (R, C, z), step number) -> noise (R, C, z)."""


def modulations(
    clock: onnxruntime.InferenceSession, timesteps: NDArray[np.int64], frames: NDArray[np.int64]
) -> FloatArray:
    """Scales and shifts of every step and row: (K, R, m, d); timesteps (K,), frames (R,).

    (K, 1, m, d) where all rows are of one length: onnxruntime normalises faster by one scale than by one for each row.
    """
    lengths, row = np.unique(frames, return_inverse=True)
    found: FloatArray = clock.run(["modulation"], {"timestep": timesteps, "frames": lengths})[0]
    return found if len(lengths) == 1 else found[:, row]


def row_network(
    context: onnxruntime.InferenceSession,
    step: onnxruntime.InferenceSession,
    known: Conditions,
    coarse: FloatArray | None,
    wiring: Wiring,
    modulation: FloatArray,
    gamma: FloatArray | None = None,
) -> RowNetwork:
    """Noise predictions of R rows, for one level.

    Args:
        context: session of context_{level}, or of context_{level}_agd.
        step: session of step_{level}, or of step_{level}_agd.
        known: K conditions.
        coarse: (K, C', z') latent of the level above for each of them.
        wiring: of contexts and rows.
        modulation: (K, R, m, d), see `modulations`.
        gamma: (A, 2) step sizes of adaptive gradient descent, for the graphs of it.
    """
    feeds = {"nodes": known.nodes, "kind": known.kind, "order": known.order}
    bias = known.bias
    if coarse is not None:
        feeds["coarse"] = coarse
        bias = np.concatenate([bias, np.repeat(known.coarse_bias, coarse.shape[1], axis=1)], axis=1)
    names = [output.name for output in context.get_outputs()]
    attended = context.run(names, feeds)
    tokens = step.get_inputs()[0].shape[1]
    spread = np.repeat(bias[wiring.context][:, None, None, :], tokens, axis=2)
    constant = {
        **{name: value[wiring.context] for name, value in zip(names, attended, strict=True)},
        **({} if gamma is None else {"gamma": gamma}),
        "src": wiring.src,
        "combine": wiring.combine,
        "bias": spread,
    }

    def predict(latents: FloatArray, number: int) -> FloatArray:
        noise: FloatArray = step.run(["noise"], {"latent": latents, "modulation": modulation[number], **constant})[0]
        return noise

    return predict
