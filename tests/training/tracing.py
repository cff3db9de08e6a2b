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

from kinegraph.contract import GraphContract
from kinegraph_export import graphs

Key = tuple[GraphContract, int, str]


class Traces:
    """Stands in for `graphs.traced`: the same module with the same weights is traced once."""

    def __init__(self, trace: Callable[[nn.Module, GraphContract, int], onnx.ModelProto]) -> None:
        self._trace = trace
        self._known: dict[Key, onnx.ModelProto] = {}

    def __call__(self, module: nn.Module, contract: GraphContract, frames_per_token: int) -> onnx.ModelProto:
        digest = hashlib.sha256(repr(module).encode())
        for value in [*module.parameters(), *module.buffers()]:
            digest.update(value.detach().numpy().tobytes())
        key = (contract, frames_per_token, digest.hexdigest())
        if key not in self._known:
            self._known[key] = self._trace(module, contract, frames_per_token)
        return copy.deepcopy(self._known[key])  # what is made of it changes it

    def forget(self, *names: str) -> int:
        """The graphs of these names are traced anew; returns how many of the names were known."""
        gone = {key for key in self._known if key[0].name in names}
        self._known = {key: model for key, model in self._known.items() if key not in gone}
        return len({contract.name for contract, *_ in gone})


@contextmanager
def traced_once(*users: ModuleType) -> Iterator[Traces]:
    """Until the end of the block, in `graphs` and in other modules that trace."""
    traces = Traces(graphs.traced)
    with pytest.MonkeyPatch.context() as patch:
        for user in (graphs, *users):
            patch.setattr(user, "traced", traces)
        yield traces
