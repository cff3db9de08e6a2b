"""An exported graph must equal the module it came from, at shapes the exporter has not seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
import onnxruntime
import torch
from torch import Tensor, nn

from kinegraph.bundle.contract import GraphContract, TensorSpec
from kinegraph.errors import KinegraphError

SHAPES = 6
"""Drawn per graph, besides the sample's own."""

MAX_INT8_ERROR = 0.15
"""Guards against a broken graph; whether int8 is good enough is told by whole clips
(`kinegraph_benchmarks.quality.precision`)."""


class ParityError(KinegraphError):
    """An exported graph differs from its module by more than the contract allows."""


Draw = Callable[[np.random.Generator], dict[str, np.ndarray]]
"""Draws one set of inputs, with other sizes every time."""


def max_difference(model: bytes, module: nn.Module, contract: GraphContract, draw: Draw) -> float:
    """Largest absolute difference over `SHAPES` random inputs.

    Args:
        model: ONNX bytes.
        module: takes the inputs in the order of the contract (keys and values as one list).
        contract: names and tolerance.
        draw: the inputs.

    Raises:
        ParityError: beyond the contract's tolerance, or an output of another shape; names graph, output and shape.
    """
    pairs = compared(model, module, contract, draw)
    return max(_difference(contract, spec, ours, theirs) for spec, ours, theirs in pairs)


def relative_error(model: bytes, module: nn.Module, contract: GraphContract, draw: Draw) -> float:
    """Length of the difference over the length of the output, the worst of `SHAPES` random inputs: for int8.

    Raises:
        ParityError: above `MAX_INT8_ERROR`, or an output of another shape.
    """
    errors = [
        float(np.linalg.norm(ours - theirs.numpy()) / max(np.linalg.norm(theirs.numpy()), 1e-9))
        for _, ours, theirs in compared(model, module, contract, draw)
    ]
    if not max(errors) <= MAX_INT8_ERROR:
        raise ParityError(f"{contract.name} in int8 is off by {max(errors):.1%}, more than {MAX_INT8_ERROR:.0%}")
    return max(errors)


def compared(
    model: bytes, module: nn.Module, contract: GraphContract, draw: Draw
) -> Iterator[tuple[TensorSpec, np.ndarray, Tensor]]:
    """Outputs of graph and module for the same inputs."""
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    rng = np.random.Generator(np.random.PCG64(0))
    for _ in range(SHAPES):
        feeds = draw(rng)
        with torch.no_grad():
            expected = module(*module_arguments(contract, feeds))
        expected = expected if isinstance(expected, tuple) else (expected,)
        found = session.run([spec.name for spec in contract.outputs], feeds)
        for spec, ours, theirs in zip(contract.outputs, found, expected, strict=True):
            if ours.shape != tuple(theirs.shape):
                raise ParityError(
                    f"{contract.name}: {spec.name} has shape {ours.shape}, the module's has {tuple(theirs.shape)}"
                )
            yield spec, ours, theirs


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
    difference = float(np.abs(ours - theirs.numpy()).max(initial=0.0))
    if not difference <= contract.tolerance:
        raise ParityError(
            f"{contract.name}: {spec.name} of shape {ours.shape} differs by {difference:.2e}, "
            f"more than {contract.tolerance:.0e}"
        )
    return difference
