"""ONNX files without the onnx package: their operators, references to other files, and weights of one file in another.

Only the protobuf framing is walked; tensor contents are skipped. Field numbers are those of onnx.proto.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from kinegraph.errors import BundleFormatError

DEFAULT_DOMAIN: Final = "ai.onnx"

_MAX_DEPTH: Final = 64
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_GRAPH_OF_MODEL, _NODE_OF_GRAPH, _INITIALIZER_OF_GRAPH = 7, 1, 5
_INPUT_OF_NODE, _OUTPUT_OF_NODE, _NAME_OF_TENSOR = 1, 2, 8


@dataclass
class _Findings:
    """Facts collected during a walk."""

    operators: set[str] = field(default_factory=set)
    external: bool = False


@dataclass(frozen=True)
class OnnxSummary:
    """Operators of a model, and whether it is complete in one file."""

    operators: tuple[str, ...]
    """Sorted `domain::OpType` of all nodes, including those of nested graphs and functions."""
    external_data: bool
    """True if any tensor keeps its content outside the file."""


def summarise(data: bytes, name: str) -> OnnxSummary:
    """List the operators of a serialised ModelProto and look for external tensor data.

    Args:
        data: content of the file.
        name: name of the file, for messages.

    Raises:
        BundleFormatError: the bytes are no ONNX model.
    """
    findings = _Findings()
    try:
        _walk(_MODEL, data, 0, len(data), findings, 0)
    except MalformedError as error:
        raise BundleFormatError(f"{name} is not an ONNX model: {error}") from None
    if not findings.operators:
        raise BundleFormatError(f"{name} is not an ONNX model: it has no operators")
    return OnnxSummary(tuple(sorted(findings.operators)), findings.external)


def check_self_contained(data: bytes, name: str) -> None:
    """Refuse a model that is not one self-contained ONNX file.

    For a model loaded from bytes, onnxruntime would search the current folder for external tensors, and take one
    special location for a memory address.

    Raises:
        BundleFormatError: external tensor data, onnxruntime's own ORT format, or no ONNX model.
    """
    if data[4:8] == b"ORTM":
        raise BundleFormatError(f"{name} is in the ORT format, whose operators cannot be listed; export it as ONNX")
    if summarise(data, name).external_data:
        raise BundleFormatError(f"{name} keeps tensors in another file; export it with all data inside")


def with_initializers(graph: bytes, source: bytes, name: str) -> bytes:
    """Add to an ONNX file the initializers (weights and constants) of another that its nodes name and it lacks.

    Two protobuf messages in a row parse as one message with the fields of both, so nothing is decoded or copied twice.

    Args:
        graph: content of the file that lacks them, or some of them, or none.
        source: content of the file that has them.
        name: of the second file, for messages.

    Raises:
        BundleFormatError: one of the files is no ONNX model; the message names the second.
    """
    found = bytearray()
    try:
        lacking = _names_without_tensor(graph)
        for tensor, start, stop in _initializers(source):
            if tensor in lacking:
                found += length_delimited(_INITIALIZER_OF_GRAPH, stop - start) + source[start:stop]
    except MalformedError as error:
        raise BundleFormatError(f"{name} is not an ONNX model: {error}") from None
    return graph + length_delimited(_GRAPH_OF_MODEL, len(found)) + bytes(found)


def _names_without_tensor(data: bytes) -> set[bytes]:
    """List what the nodes of a model read and neither a node nor an initializer gives."""
    read: set[bytes] = set()
    given = {name for name, _, _ in _initializers(data)}
    for start, stop in nested(data, 0, len(data), _GRAPH_OF_MODEL):
        for begin, end in nested(data, start, stop, _NODE_OF_GRAPH):
            read.update(data[first:last] for first, last in nested(data, begin, end, _INPUT_OF_NODE))
            given.update(data[first:last] for first, last in nested(data, begin, end, _OUTPUT_OF_NODE))
    return read - given


def _initializers(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Yield name, first byte and end of each initializer of a model."""
    for start, stop in nested(data, 0, len(data), _GRAPH_OF_MODEL):
        for begin, end in nested(data, start, stop, _INITIALIZER_OF_GRAPH):
            for first, last in nested(data, begin, end, _NAME_OF_TENSOR):
                yield data[first:last], begin, end


def nested(data: bytes, start: int, end: int, number: int) -> Iterator[tuple[int, int]]:
    """Yield first byte and end of each field of a number that holds bytes."""
    for found, wire, begin, stop in fields(data, start, end):
        if (found, wire) == (number, _BYTES):
            yield begin, stop


def length_delimited(number: int, length: int) -> bytes:
    """Encode the head of a field whose content has `length` bytes."""
    head = bytearray([number << 3 | _BYTES])
    while length >= 0x80:
        head.append(length & 0x7F | 0x80)
        length >>= 7
    return bytes([*head, length])


class MalformedError(Exception):
    """The bytes are not valid protobuf."""


_Visitor = Callable[[bytes, int, int, "_Findings", int], None]


def _walk(message: Mapping[int, _Visitor], data: bytes, start: int, end: int, findings: _Findings, depth: int) -> None:
    if depth > _MAX_DEPTH:
        raise MalformedError(f"nested deeper than {_MAX_DEPTH}")
    for number, wire, begin, stop in fields(data, start, end):
        visit = message.get(number)
        if visit is not None and wire == _BYTES:
            visit(data, begin, stop, findings, depth + 1)


def fields(data: bytes, start: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield number, wire type, first byte and end of the content of each field."""
    position = start
    while position < end:
        key, position = _varint(data, position, end)
        number, wire = key >> 3, key & 7
        begin = position
        if wire == _BYTES:
            length, begin = _varint(data, position, end)
            position = begin + length
        elif wire == _VARINT:
            position = _varint(data, position, end)[1]
        elif wire in (_FIXED32, _FIXED64):
            position += 4 if wire == _FIXED32 else 8
        else:
            raise MalformedError(f"wire type {wire}")
        if position > end or number == 0:
            raise MalformedError("a field runs past its end")
        yield number, wire, begin, position


def _varint(data: bytes, position: int, end: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if position >= end:
            raise MalformedError("cut short")
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
    raise MalformedError("a number longer than 64 bits")


def _node(data: bytes, start: int, end: int, findings: _Findings, depth: int) -> None:
    operator = domain = b""
    for number, wire, begin, stop in fields(data, start, end):
        if wire != _BYTES:
            continue
        if number == 4:
            operator = data[begin:stop]
        elif number == 7:
            domain = data[begin:stop]
        elif number == 5:
            _walk(_ATTRIBUTE, data, begin, stop, findings, depth + 1)
    try:
        findings.operators.add(f"{domain.decode() or DEFAULT_DOMAIN}::{operator.decode()}")
    except UnicodeDecodeError as error:
        raise MalformedError("an operator's name is not text") from error


def _tensor(data: bytes, start: int, end: int, findings: _Findings, depth: int) -> None:
    for number, wire, begin, stop in fields(data, start, end):
        location = number == 14 and wire == _VARINT and _varint(data, begin, stop)[0] != 0
        if location or number == 13:
            findings.external = True


def _message(table: Mapping[int, _Visitor]) -> _Visitor:
    def visit(data: bytes, start: int, end: int, findings: _Findings, depth: int) -> None:
        _walk(table, data, start, end, findings, depth)

    return visit


_SPARSE: Final[dict[int, _Visitor]] = {1: _tensor, 2: _tensor}
_GRAPH: Final[dict[int, _Visitor]] = {1: _node, 5: _tensor, 15: _message(_SPARSE)}
_ATTRIBUTE: Final[dict[int, _Visitor]] = {
    5: _tensor,
    6: _message(_GRAPH),
    10: _tensor,
    11: _message(_GRAPH),
    22: _message(_SPARSE),
    23: _message(_SPARSE),
}
_FUNCTION: Final[dict[int, _Visitor]] = {7: _node, 11: _message(_ATTRIBUTE)}
_TRAINING: Final[dict[int, _Visitor]] = {1: _message(_GRAPH), 2: _message(_GRAPH)}
_MODEL: Final[dict[int, _Visitor]] = {7: _message(_GRAPH), 20: _message(_TRAINING), 25: _message(_FUNCTION)}
