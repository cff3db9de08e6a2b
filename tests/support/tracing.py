"""Trace each module once in a whole run of the tests: torch's exporter takes seconds a graph, and many tests export.

Models are kept in a folder that all workers of pytest-xdist share, by what a module is: its classes and settings, its
weights, and the inputs that it is traced with. The exporter's table of operators, which it makes anew for every graph,
is made once in each process.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import onnx
import pytest
import torch
from torch import nn
from torch.onnx._internal.exporter._registration import ONNXRegistry

from kinegraph_export import clip_text_encoder, export_evaluator, graphs
from kinegraph_export.official import graphs as official_graphs

PLAIN = (bool, int, float, str, bytes, dict, type(None))
ToOnnx = Callable[[nn.Module, tuple[Any, ...], Sequence[str], Sequence[str], tuple[Any, ...]], onnx.ModelProto]


def digest_of(module: nn.Module, *arguments: object) -> str:
    """Hash what a module computes with: classes, attributes, weights and buffers, and the arguments of its trace."""
    digest = hashlib.sha256()
    for name, part in module.named_modules():
        attributes = {key: _described(value) for key, value in vars(part).items() if not key.startswith("_")}
        digest.update(repr((name, type(part).__qualname__, part.extra_repr(), sorted(attributes.items()))).encode())
    for name, value in [*module.named_parameters(), *module.named_buffers()]:
        digest.update(repr((name, _described(value))).encode())
    digest.update(repr([_described(argument, shape_alone=True) for argument in arguments]).encode())
    return digest.hexdigest()


def _described(value: object, *, shape_alone: bool = False) -> object:
    """Describe plain values, records and tensors as they are, other objects by their class.

    Args:
        value: also lists of such.
        shape_alone: describe tensors by shape and type: the numbers of sample inputs leave no trace.
    """
    if isinstance(value, torch.Tensor):
        numbers = b"" if shape_alone else value.detach().contiguous().numpy().tobytes()
        return tuple(value.shape), value.dtype, hashlib.sha256(numbers).hexdigest()
    if isinstance(value, list | tuple):
        return [_described(item, shape_alone=shape_alone) for item in value]
    if shape_alone or isinstance(value, PLAIN) or is_dataclass(value):
        return value
    return type(value).__qualname__


class Traces:
    """Replacement of `to_onnx` that traces the same module with the same weights once."""

    def __init__(self, trace: ToOnnx, folder: Path) -> None:
        self._trace, self._folder = trace, folder
        self._pending: set[str] = set()
        """Classes of modules of which the next one is traced again."""

    def __call__(
        self,
        module: nn.Module,
        example_inputs: tuple[Any, ...],
        input_names: Sequence[str],
        output_names: Sequence[str],
        dynamic_shapes: tuple[Any, ...],
    ) -> onnx.ModelProto:
        """Trace as `to_onnx` does, or take what was traced before."""
        arguments = (example_inputs, tuple(input_names), tuple(output_names), dynamic_shapes)
        path = self._folder / f"{digest_of(module, *arguments)}.onnx"
        kind = type(module).__name__
        if path.is_file() and kind not in self._pending:
            return onnx.load_model_from_string(path.read_bytes())
        self._pending.discard(kind)
        model = self._trace(module, *arguments)
        unfinished = path.with_suffix(f".{os.getpid()}")
        unfinished.write_bytes(model.SerializeToString())
        unfinished.replace(path)  # in one go: other workers read it
        return model

    def anew(self, *kinds: str) -> set[str]:
        """Trace the next module of each of these classes again; returns the set of those that were not traced yet."""
        self._pending = set(kinds)
        return self._pending


@contextmanager
def traced_once(folder: Path) -> Iterator[Traces]:
    """Install the cache in the modules that call `to_onnx`, until the end of the block."""
    traces = Traces(graphs.to_onnx, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ONNXRegistry, "from_torchlib", staticmethod(cache(ONNXRegistry.from_torchlib)))
        for user in (graphs, official_graphs, clip_text_encoder, export_evaluator):
            patch.setattr(user, "to_onnx", traces)
        yield traces
