"""A whole bundle of a few kilobytes whose graphs keep the contract and compute zeros.

The ONNX files are written field by field, so that runtime tests need no onnx package.
"""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.bundle.contract import (
    FORMAT_VERSION,
    FRAME_FILES,
    LEVELS,
    NODE_KINDS,
    GraphContract,
    LevelSpec,
    TensorSpec,
    contracts,
)
from kinegraph.bundle.frames_part import FramesPart, frame_contracts
from kinegraph.bundle.manifest import (
    Defaults,
    FeatureSpec,
    FrameSpec,
    Licence,
    Manifest,
    ScheduleSpec,
    SkeletonSpec,
    TextSpec,
    describe_file,
    encode_manifest,
    seal,
)
from kinegraph.graph import ROLES
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS

TEXT_WIDTH = 12
TRAIN_STEPS = 20
MAX_FRAMES = 24
LEVEL_SPECS = {
    name: LevelSpec(tokens, 3, 8, 2, 2, NODE_KINDS[: index + 1])
    for index, (name, tokens) in enumerate(zip(LEVELS, (1, 2, 4), strict=True))
}
FRAMES_PART = FramesPart(LevelSpec(49, 4 * 137, 8, 2, 2, NODE_KINDS), 4, 0.5, 5, 2.5, "clean")
FILLER_OPERATORS = ("ai.onnx::Cast", "ai.onnx::ConstantOfShape", "ai.onnx::Unique")


def varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def field(number: int, value: int | str | bytes) -> bytes:
    """Encode one protobuf field: a varint, or a length and bytes."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def value_info(spec: TensorSpec) -> bytes:
    dims = b"".join(field(1, field(1, axis) if isinstance(axis, int) else field(2, axis)) for axis in spec.axes)
    element = {"float32": 1, "int64": 7}[spec.dtype]
    return field(1, spec.name) + field(2, field(1, field(1, element) + field(2, dims)))


def node(op: str, inputs: Sequence[str], outputs: Sequence[str], attributes: bytes = b"", domain: str = "") -> bytes:
    names = b"".join(field(1, name) for name in inputs) + b"".join(field(2, name) for name in outputs)
    return names + field(4, op) + field(7, domain) + attributes


def model(nodes: Sequence[bytes], inputs: bytes = b"", outputs: bytes = b"", initializers: bytes = b"") -> bytes:
    graph = b"".join(field(1, item) for item in nodes) + field(2, "graph") + initializers + inputs + outputs
    return field(1, 8) + field(8, field(2, 17)) + field(7, graph)


def filler_model(contract: GraphContract) -> bytes:
    """Build a model that onnxruntime loads, with the contract's inputs and outputs.

    Every output is zeros of a size that shape inference cannot tell, so that any declared shape is accepted. The
    gradient of a decoder has the features among its tensors (`bundle.onnx_split`).
    """
    to_int = field(5, field(1, "to") + field(3, 7) + field(20, 2))
    features = ("features",) if any(spec.name == "cotangent" for spec in contract.inputs) else ()
    nodes = [
        node("Unique", [contract.inputs[0].name], ["unique"]),
        node("Cast", ["unique"], ["sizes"], to_int),
        *(node("ConstantOfShape", ["sizes"], [name]) for name in features),
        *(node("Cast", [name], ["more"], to_int) for name in features),
        *(node("ConstantOfShape", ["more" if features else "sizes"], [spec.name]) for spec in contract.outputs),
    ]
    inputs = b"".join(field(11, value_info(spec)) for spec in contract.inputs)
    outputs = b"".join(field(12, value_info(spec)) for spec in contract.outputs)
    return model(nodes, inputs, outputs)


def tables_npz(**changes: np.ndarray) -> bytes:
    arrays = {"bone_lengths": np.full((1, 21), 0.25, dtype=np.float32)}
    buffer = io.BytesIO()
    np.savez(buffer, **{**arrays, **changes})
    return buffer.getvalue()


def bundle_files(version: int = FORMAT_VERSION) -> dict[str, bytes]:
    """Build the content of every file of the synthetic bundle but the manifest."""
    graphs = contracts(LEVEL_SPECS, TEXT_WIDTH, 137, version)
    if version == FORMAT_VERSION:
        graphs |= frame_contracts(FRAMES_PART.level, TEXT_WIDTH)
    files = {contract.file: filler_model(contract) for contract in graphs.values()}
    files["tokenizer.json"] = b'{"version": "1.0"}'
    files["parser.bin"] = bytes(range(256)) * 2
    files["tables.npz"] = tables_npz()
    return files


def manifest_for(files: Mapping[str, bytes], version: int = FORMAT_VERSION) -> Manifest:
    graphs = sorted(name for name in files if name.endswith(".onnx"))
    return Manifest(
        format_version=version,
        name="synthetic",
        version="0.0.1",
        licence=Licence("Apache-2.0", "CC0-1.0", "none", "Apache-2.0", "MIT"),
        provenance={"training_data": "none", "built_with": "tests"},
        scope={"actions": "none", "cannot": "move"},
        skeleton=SkeletonSpec(JOINT_NAMES, PARENTS),
        fps=20.0,
        frames=FrameSpec(8, MAX_FRAMES, 4),
        features=FeatureSpec("joints-137", "true", tuple(float(i) for i in range(137)), (1.5,) * 137),
        text=TextSpec(TEXT_WIDTH, "[MASK]"),
        levels=LEVEL_SPECS,
        schedule=ScheduleSpec(TRAIN_STEPS, 8.5e-4, 0.012, 1, "leading", "epsilon"),
        defaults=Defaults({"motion": 3, "action": 4, "specific": 5}, dict.fromkeys(LEVELS, 2.5), "coarse", 1.0),
        roles=ROLES,
        precision="fp32",
        files={name: describe_file(data) for name, data in sorted(files.items())},
        operators=dict.fromkeys(graphs, FILLER_OPERATORS),
        parity={"decoder": 1e-6},
        training={"steps": 10, "rate": 1e-3, "data": "none"},
        quality={"jerk": 1.25},
        frames_part=FRAMES_PART if set(files) >= FRAME_FILES else None,
    )


def write_bundle(
    folder: Path, contents: Mapping[str, bytes] | None = None, version: int = FORMAT_VERSION, **changes: Any
) -> Path:
    """Write a bundle of a format version into a new folder; `changes` replace fields of the manifest."""
    contents = bundle_files(version) if contents is None else contents
    folder.mkdir()
    for name, data in contents.items():
        (folder / name).write_bytes(data)
    manifest = dataclasses.replace(manifest_for(contents, version), **changes)
    (folder / "manifest.json").write_bytes(encode_manifest(manifest))
    return folder


def manifest_object() -> dict[str, Any]:
    """Return the manifest as parsed JSON without its seal, for tests to break."""
    value = json.loads(encode_manifest(manifest_for(bundle_files())))
    del value["sha256"]
    return value


def sealed(value: object) -> bytes:
    """Encode a broken manifest with a valid seal, so that only the decoder can object."""
    return seal(json.dumps(value, indent=1).removesuffix("\n}").encode())
