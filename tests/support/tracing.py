"""Trace each module once for all tests: torch's exporter takes seconds, and tests export the same module repeatedly."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType

import onnx
import pytest
from torch import nn

from kinegraph.bundle.contract import GraphContract
from kinegraph_export import graphs

Key = tuple[GraphContract, int, str]


class Traces:
    """Replacement of `graphs.trace_to_onnx` that traces the same module with the same weights once."""

    def __init__(self, trace: Callable[[nn.Module, GraphContract, int], onnx.ModelProto]) -> None:
        self._trace = trace
        self._cache: dict[Key, onnx.ModelProto] = {}
        self._uncached: frozenset[str] = frozenset()
        self._retraced: set[str] = set()

    def __call__(self, module: nn.Module, contract: GraphContract, frames_per_token: int) -> onnx.ModelProto:
        if contract.name in self._uncached:
            self._retraced.add(contract.name)
            return self._trace(module, contract, frames_per_token)
        digest = hashlib.sha256(repr(module).encode())
        for value in [*module.parameters(), *module.buffers()]:
            digest.update(value.detach().numpy().tobytes())
        key = (contract, frames_per_token, digest.hexdigest())
        if key not in self._cache:
            self._cache[key] = self._trace(module, contract, frames_per_token)
        return copy.deepcopy(self._cache[key])  # callers change the model

    @contextmanager
    def anew(self, *names: str) -> Iterator[set[str]]:
        """Trace graphs of these names again inside the block; yield the set of names that were."""
        self._uncached, self._retraced = frozenset(names), set()
        yield self._retraced
        self._uncached = frozenset()


@contextmanager
def traced_once(*users: ModuleType) -> Iterator[Traces]:
    """Install the cache in `graphs` and in other modules that trace, until the end of the block."""
    traces = Traces(graphs.trace_to_onnx)
    with pytest.MonkeyPatch.context() as patch:
        for user in (graphs, *users):
            patch.setattr(user, "trace_to_onnx", traces)
        yield traces
