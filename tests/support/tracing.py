"""Tracing a module takes torch's exporter seconds, and tests export the same modules in several precisions."""

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
    """Stands in for `graphs.traced`: the same module with the same weights is traced once."""

    def __init__(self, trace: Callable[[nn.Module, GraphContract, int], onnx.ModelProto]) -> None:
        self._trace = trace
        self._known: dict[Key, onnx.ModelProto] = {}
        self._anew: frozenset[str] = frozenset()
        self._done: set[str] = set()

    def __call__(self, module: nn.Module, contract: GraphContract, frames_per_token: int) -> onnx.ModelProto:
        if contract.name in self._anew:
            self._done.add(contract.name)
            return self._trace(module, contract, frames_per_token)
        digest = hashlib.sha256(repr(module).encode())
        for value in [*module.parameters(), *module.buffers()]:
            digest.update(value.detach().numpy().tobytes())
        key = (contract, frames_per_token, digest.hexdigest())
        if key not in self._known:
            self._known[key] = self._trace(module, contract, frames_per_token)
        return copy.deepcopy(self._known[key])  # what is made of it changes it

    @contextmanager
    def anew(self, *names: str) -> Iterator[set[str]]:
        """In the block, graphs of these names are traced whatever is known; gives the names that were."""
        self._anew, self._done = frozenset(names), set()
        yield self._done
        self._anew = frozenset()


@contextmanager
def traced_once(*users: ModuleType) -> Iterator[Traces]:
    """Until the end of the block, in `graphs` and in other modules that trace."""
    traces = Traces(graphs.traced)
    with pytest.MonkeyPatch.context() as patch:
        for user in (graphs, *users):
            patch.setattr(user, "traced", traces)
        yield traces
