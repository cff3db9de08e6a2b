"""Compare an exported graph with the module that it came from, at shapes that the exporter has not seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
import onnxruntime
import torch
from torch import Tensor, nn

from kinegraph.bundle.contract import GraphContract, TensorSpec
from kinegraph.errors import KinegraphError

RANDOM_INPUTS = 6
"""Sets of random inputs that a graph is compared on."""

MAX_INT8_ERROR = 0.15
"""Largest relative error of an int8 graph.

It guards against a broken graph only; whole clips tell whether int8 is good enough
(`kinegraph_benchmarks.quality.precision`)."""


class ParityError(KinegraphError):
    """An exported graph differs from its module by more than the contract allows."""


InputGenerator = Callable[[np.random.Generator], dict[str, np.ndarray]]
"""Draws one set of inputs by name, with other sizes at every call."""


def max_difference(model: bytes, module: nn.Module, contract: GraphContract, draw: InputGenerator) -> float:
    """Measure the largest absolute difference over `RANDOM_INPUTS` random inputs.

    Args:
        model: ONNX bytes.
        module: takes the inputs in the order of the contract (keys and values as one list).
        contract: names and tolerance.
        draw: generator of inputs.

    Raises:
        ParityError: beyond the contract's tolerance, or an output of another shape; names graph, output and shape.
    """
    pairs = run_both(model, module, contract, draw)
    return max(_check_difference(contract, spec, ours, theirs) for spec, ours, theirs in pairs)


def relative_error(model: bytes, module: nn.Module, contract: GraphContract, draw: InputGenerator) -> float:
    """Measure the relative error of an int8 graph, the largest over `RANDOM_INPUTS` random inputs.

    The error of one output is the norm of the difference over the norm of the module's output.

    Raises:
        ParityError: above `MAX_INT8_ERROR`, or an output of another shape.
    """
    errors = [
        float(np.linalg.norm(ours - theirs.numpy()) / max(np.linalg.norm(theirs.numpy()), 1e-9))
        for _, ours, theirs in run_both(model, module, contract, draw)
    ]
    if not max(errors) <= MAX_INT8_ERROR:
        raise ParityError(f"{contract.name} in int8 is off by {max(errors):.1%}, more than {MAX_INT8_ERROR:.0%}")
    return max(errors)


def run_both(
    model: bytes, module: nn.Module, contract: GraphContract, draw: InputGenerator
) -> Iterator[tuple[TensorSpec, np.ndarray, Tensor]]:
    """Run graph and module on the same random inputs.

    Yields:
        Each output: its specification, the graph's value, the module's value.

    Raises:
        ParityError: an output has another shape.
    """
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    rng = np.random.Generator(np.random.PCG64(0))
    for _ in range(RANDOM_INPUTS):
        feeds = draw(rng)
        with torch.no_grad():
            expected = module(*module_arguments(contract, feeds))
        expected = expected if isinstance(expected, tuple) else (expected,)
        outputs = session.run([spec.name for spec in contract.outputs], feeds)
        for spec, ours, theirs in zip(contract.outputs, outputs, expected, strict=True):
            if ours.shape != tuple(theirs.shape):
                raise ParityError(
                    f"{contract.name}: {spec.name} has shape {ours.shape}, the module's has {tuple(theirs.shape)}"
                )
            yield spec, ours, theirs


def module_arguments(contract: GraphContract, feeds: Mapping[str, np.ndarray]) -> list[Tensor | list[Tensor]]:
    """Arrange inputs as the module's arguments: in the contract's order, key_0, value_0, ... as one list."""
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


def _check_difference(contract: GraphContract, spec: TensorSpec, ours: np.ndarray, theirs: Tensor) -> float:
    """Measure one output's largest difference, and raise ParityError beyond the contract's tolerance."""
    difference = float(np.abs(ours - theirs.numpy()).max(initial=0.0))
    if not difference <= contract.tolerance:
        raise ParityError(
            f"{contract.name}: {spec.name} of shape {ours.shape} differs by {difference:.2e}, "
            f"more than {contract.tolerance:.0e}"
        )
    return difference
