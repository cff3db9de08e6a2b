"""An exported graph must equal the module it came from, at shapes the exporter has not seen."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import onnxruntime
import torch
from torch import Tensor, nn

from kinegraph.contract import GraphContract, TensorSpec
from kinegraph.errors import KinegraphError

SHAPES = 6
"""Drawn per graph, besides the sample's own."""


class ParityError(KinegraphError):
    """An exported graph differs from its module by more than the contract allows."""


def max_difference(
    model: bytes,
    module: nn.Module,
    contract: GraphContract,
    inputs: Callable[[np.random.Generator], dict[str, np.ndarray]],
) -> float:
    """Largest absolute difference over `SHAPES` random inputs.

    Args:
        model: ONNX bytes.
        module: takes the inputs in the order of the contract (keys and values as one list).
        contract: names and tolerance.
        inputs: draws one set of inputs, with other sizes every time.

    Raises:
        ParityError: beyond the contract's tolerance, or an output of another shape; names graph, output and shape.
    """
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    rng = np.random.Generator(np.random.PCG64(0))
    worst = 0.0
    for _ in range(SHAPES):
        feeds = inputs(rng)
        with torch.no_grad():
            expected = module(*module_arguments(contract, feeds))
        expected = expected if isinstance(expected, tuple) else (expected,)
        found = session.run([spec.name for spec in contract.outputs], feeds)
        for spec, ours, theirs in zip(contract.outputs, found, expected, strict=True):
            worst = max(worst, _difference(contract, spec, ours, theirs))
    return worst


def module_arguments(contract: GraphContract, feeds: Mapping[str, np.ndarray]) -> list[Tensor | list[Tensor]]:
    """Tensors in the contract's order; key_0, value_0, ... become one list."""
    arguments: list[Tensor | list[Tensor]] = []
    context: list[Tensor] = []
    for spec in contract.inputs:
        tensor = torch.from_numpy(feeds[spec.name])
        if spec.name.startswith(("key_", "value_")):
            if not context:
                arguments.append(context)
            context.append(tensor)
        else:
            arguments.append(tensor)
    return arguments


def _difference(contract: GraphContract, spec: TensorSpec, ours: np.ndarray, theirs: Tensor) -> float:
    if ours.shape != tuple(theirs.shape):
        raise ParityError(
            f"{contract.name}: {spec.name} has shape {ours.shape}, the module's has {tuple(theirs.shape)}"
        )
    difference = float(np.abs(ours - theirs.numpy()).max(initial=0.0))
    if not difference <= contract.tolerance:
        raise ParityError(
            f"{contract.name}: {spec.name} of shape {ours.shape} differs by {difference:.2e}, "
            f"more than {contract.tolerance:.0e}"
        )
    return difference
