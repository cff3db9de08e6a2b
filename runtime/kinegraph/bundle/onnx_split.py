"""The graph of a decoder's gradient in two: the decoder with what its gradient needs, and the way back.

`kinegraph_export.reverse_mode` stores the nodes of a decoder and of its vector-Jacobian product in one file. Whoever
descends an energy needs the features first, computes the energy's gradient with respect to them, and only then goes
back to the latent. Run in two parts, the decoder runs once for both (Griewank & Walther, *Evaluating Derivatives*,
2008, section 3.2: the values of the forward sweep are kept for the reverse sweep).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass

from kinegraph.bundle.onnx_inspect import MalformedError, fields, length_delimited, nested
from kinegraph.errors import BundleFormatError

_GRAPH_OF_MODEL = 7
_NODE, _NAME, _INITIALIZER, _INPUT, _OUTPUT = 1, 2, 5, 11, 12
"""Fields of a GraphProto."""
_INPUT_OF_NODE, _OUTPUT_OF_NODE, _NAME_OF_TENSOR, _NAME_OF_VALUE = 1, 2, 8, 1
_FLOATS = bytes([0x12, 0x04, 0x0A, 0x02, 0x08, 0x01])
"""Type of a ValueInfoProto: a tensor of float32, of any shape."""


@dataclass(frozen=True)
class SplitGraph:
    """Two ONNX files in place of one."""

    forward: bytes
    """Gives the features, and what is kept."""
    backward: bytes
    """Reads what is kept, and the cotangent; gives the gradient."""
    kept: tuple[str, ...]
    """Tensors of float32 that the first gives and the second reads."""


def split_gradient(model: bytes, name: str, features: str = "features", gradient: str = "gradient") -> SplitGraph:
    """Split the graph of a gradient where the features of its decoder are known.

    What depends on constants alone is in both parts.

    Args:
        model: ONNX file with all weights inside.
        name: of the file, for messages.
        features: tensor that the decoder gives.
        gradient: output of the graph.

    Raises:
        BundleFormatError: the bytes are no ONNX model, or have no such tensors.
    """
    try:
        graph = _Graph.read(model)
    except MalformedError as error:
        raise BundleFormatError(f"{name} is not an ONNX model: {error}") from None
    given = {tensor for node in graph.nodes for tensor in node.outputs}
    for tensor in (features, gradient):
        if tensor.encode() not in given:
            raise BundleFormatError(f"{name} has no tensor {tensor!r}, so that it is no gradient of a decoder")
    constant = graph.constants()
    before, first_read = _needed(graph.nodes, features.encode(), frozenset())
    known = frozenset(tensor for node in before for tensor in node.outputs) - constant
    after, read = _needed(graph.nodes, gradient.encode(), known)
    kept = sorted(read & known)
    outputs = [features.encode(), *(tensor for tensor in kept if tensor != features.encode())]
    forward = graph.part(before, first_read, [], outputs)
    unread = graph.inputs.keys() - first_read  # so that both together have all inputs
    backward = graph.part(after, read | unread, kept, [gradient.encode()])
    return SplitGraph(forward, backward, tuple(tensor.decode() for tensor in kept))


@dataclass(frozen=True)
class _Node:
    """A node: its bytes, and the names of what it reads and gives."""

    data: bytes
    inputs: tuple[bytes, ...]
    outputs: tuple[bytes, ...]


@dataclass(frozen=True)
class _Graph:
    """The parts of a model, in the order of the file."""

    head: bytes
    """Fields of the model beside its graph."""
    name: bytes
    nodes: tuple[_Node, ...]
    initializers: dict[bytes, bytes]
    inputs: dict[bytes, bytes]
    outputs: dict[bytes, bytes]

    @staticmethod
    def read(model: bytes) -> _Graph:
        """Read a model; it may have its graph in several messages (`onnx_inspect.with_initializers`)."""
        head, name = bytearray(), b""
        nodes: list[_Node] = []
        named: dict[int, dict[bytes, bytes]] = {_INITIALIZER: {}, _INPUT: {}, _OUTPUT: {}}
        for number, start, begin, stop in _framed(model, 0, len(model)):
            if number != _GRAPH_OF_MODEL:
                head += model[start:stop]
                continue
            for part, _, first, last in _framed(model, begin, stop):
                if part == _NODE:
                    inputs, outputs = (_texts(model, first, last, side) for side in (_INPUT_OF_NODE, _OUTPUT_OF_NODE))
                    nodes.append(_Node(model[first:last], inputs, outputs))
                elif part in named:
                    key = _NAME_OF_TENSOR if part == _INITIALIZER else _NAME_OF_VALUE
                    named[part].update(dict.fromkeys(_texts(model, first, last, key), model[first:last]))
                elif part == _NAME:
                    name = model[first:last]
        return _Graph(bytes(head), name, tuple(nodes), named[_INITIALIZER], named[_INPUT], named[_OUTPUT])

    def constants(self) -> frozenset[bytes]:
        """List the tensors that depend on no input."""
        known = {*self.initializers, b""}
        for node in self.nodes:
            if known.issuperset(node.inputs):
                known.update(node.outputs)
        return frozenset(known)

    def part(
        self, nodes: Sequence[_Node], read: Set[bytes], further: Sequence[bytes], outputs: Sequence[bytes]
    ) -> bytes:
        """Write a model of some of the nodes, with the weights and inputs that are read, and further float32 inputs."""
        body = bytearray(_field(_NAME, self.name))
        for node in nodes:
            body += _field(_NODE, node.data)
        for number, named in ((_INITIALIZER, self.initializers), (_INPUT, self.inputs)):
            for name, data in named.items():
                if name in read:
                    body += _field(number, data)
        for number, names in ((_INPUT, further), (_OUTPUT, outputs)):
            for name in names:
                known = self.outputs.get(name) if number == _OUTPUT else None
                body += _field(number, known or _field(_NAME_OF_VALUE, name) + _FLOATS)
        return self.head + _field(_GRAPH_OF_MODEL, bytes(body))


def _needed(nodes: Sequence[_Node], wanted: bytes, known: frozenset[bytes]) -> tuple[list[_Node], set[bytes]]:
    """List the nodes that a tensor depends on beyond what is known, and all that they read."""
    chosen: list[_Node] = []
    read = {wanted}
    for node in reversed(nodes):
        if (read - known).intersection(node.outputs):
            chosen.append(node)
            read.update(node.inputs)
    return chosen[::-1], read


def _framed(data: bytes, start: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield number, first byte of the head, first byte and end of the content of each field."""
    head = start
    for number, _, begin, stop in fields(data, start, end):
        yield number, head, begin, stop
        head = stop


def _texts(data: bytes, start: int, end: int, number: int) -> tuple[bytes, ...]:
    return tuple(data[first:last] for first, last in nested(data, start, end, number))


def _field(number: int, content: bytes) -> bytes:
    return length_delimited(number, len(content)) + content
