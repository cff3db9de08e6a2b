"""The content of a bundle's files: tables, graphs and operators, and what `verify` reports."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from kinegraph.bundle.contract import contracts
from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.verify import verify_bundle
from kinegraph.errors import BundleError, BundleFormatError
from support.synthetic_bundle import (
    FILLER_OPERATORS,
    LEVEL_SPECS,
    bundle_files,
    field,
    filler_model,
    manifest_for,
    model,
    node,
    tables_npz,
    write_bundle,
)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"no archive", "not an npz"),
        (tables_npz()[:-40], "not an npz"),
        (tables_npz(extra=np.zeros(1)), "may hold"),
        (tables_npz(bone_lengths=np.zeros((1, 22), np.float32)), "larger than|must be float32"),
        (tables_npz(bone_lengths=np.zeros((1, 20), np.float32)), "must be float32"),
        (tables_npz(bone_lengths=np.zeros((1, 21), np.float64)), "must be float32"),
        (tables_npz(bone_lengths=np.full((1, 21), np.nan, np.float32)), "NaN"),
        (tables_npz(duration=np.zeros((10**6, 8), np.float32)), "larger than"),
    ],
    ids=["bytes", "cut", "extra", "wide", "short", "double", "nan", "bomb"],
)
def test_broken_tables_are_refused(tmp_path: Path, data: bytes, message: str) -> None:
    folder = write_bundle(tmp_path / "tables", {**bundle_files(), "tables.npz": data})
    with pytest.raises(BundleFormatError, match=rf"tables\.npz.*({message})"):
        read_bundle(folder)


class Bomb:
    """An object whose unpickling would create a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.path,)


def test_a_pickle_in_the_tables_is_not_opened(tmp_path: Path) -> None:
    trap = np.empty((1, 21), dtype=object)
    trap[:] = Bomb(tmp_path / "executed")
    folder = write_bundle(tmp_path / "pickle", {**bundle_files(), "tables.npz": tables_npz(bone_lengths=trap)})
    with pytest.raises(BundleFormatError, match=r"tables\.npz"):
        read_bundle(folder)
    assert not (tmp_path / "executed").exists()


def test_a_repeated_member_of_the_tables_is_refused(tmp_path: Path) -> None:
    buffer = io.BytesIO(tables_npz())
    with zipfile.ZipFile(buffer, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("bone_lengths.npy", b"another one")
    folder = write_bundle(tmp_path / "twice", {**bundle_files(), "tables.npz": buffer.getvalue()})
    with pytest.raises(BundleFormatError, match="once each"):
        read_bundle(folder)


def external_decoder(location: str) -> bytes:
    """Build a decoder with an initializer that refers to another file."""
    entry = field(13, field(1, "location") + field(2, location))
    tensor = field(1, 4) + field(2, 1) + field(8, "weights") + entry + field(14, 1)
    contract = contracts(LEVEL_SPECS, 12, 137)["decoder"]
    whole = filler_model(contract)
    # A second `graph` field is merged into the first by every protobuf reader.
    return whole + field(7, field(5, tensor))


@pytest.mark.usefixtures("no_sessions")
@pytest.mark.parametrize(
    "location", ["weights.bin", "../weights.bin", "/etc/hostname", "parser.bin", "*/_ORT_MEM_ADDR_/*"]
)
def test_tensors_outside_the_file_are_refused(tmp_path: Path, location: str) -> None:
    folder = write_bundle(tmp_path / "external", {**bundle_files(), "decoder.onnx": external_decoder(location)})
    with pytest.raises(BundleFormatError, match=r"decoder\.onnx keeps tensors in another file"):
        read_bundle(folder)


@pytest.mark.usefixtures("no_sessions")
def test_the_ort_format_is_refused(tmp_path: Path) -> None:
    folder = write_bundle(tmp_path / "ort", {**bundle_files(), "decoder.onnx": b"\x18\0\0\0ORTM" + bytes(64)})
    with pytest.raises(BundleFormatError, match=r"decoder\.onnx is in the ORT format"):
        read_bundle(folder)


def test_verify_tells_what_it_checked(bundle: Path) -> None:
    report = verify_bundle(bundle)
    assert (report.name, report.version) == ("synthetic", "0.0.1")
    assert report.files == {name: len(data) for name, data in bundle_files().items()}
    assert report.operators == {f"{name}.onnx": len(FILLER_OPERATORS) for name in report.sessions}


def test_verify_refuses_an_operator_that_is_not_listed(tmp_path: Path) -> None:
    contract = contracts(LEVEL_SPECS, 12, 137)["decoder"]
    foreign = filler_model(contract) + field(7, field(1, node("Identity", ["unique"], ["spare"])))
    folder = write_bundle(tmp_path / "foreign", {**bundle_files(), "decoder.onnx": foreign})
    with pytest.raises(BundleFormatError, match=r"decoder\.onnx uses the operator ai\.onnx::Identity"):
        verify_bundle(folder)


def test_verify_refuses_a_listed_operator_that_is_not_there(tmp_path: Path) -> None:
    operators = dict(manifest_for(bundle_files()).operators)
    operators["decoder.onnx"] = ("ai.onnx::Add", *FILLER_OPERATORS)
    folder = write_bundle(tmp_path / "listed", operators=operators)
    with pytest.raises(BundleFormatError, match=r"lists ai\.onnx::Add for decoder\.onnx"):
        verify_bundle(folder)


def test_verify_refuses_a_graph_that_breaks_the_contract(tmp_path: Path) -> None:
    swapped = {**bundle_files(), "denoiser_motion.onnx": bundle_files()["denoiser_action.onnx"]}
    with pytest.raises(BundleFormatError, match=r"denoiser_motion\.onnx: input 'latent'"):
        verify_bundle(write_bundle(tmp_path / "swapped", swapped))


def test_verify_refuses_what_onnxruntime_refuses(tmp_path: Path) -> None:
    broken = {**bundle_files(), "decoder.onnx": model([node("NoSuchOperator", [], ["out"])])}
    operators = {**manifest_for(bundle_files()).operators, "decoder.onnx": ("ai.onnx::NoSuchOperator",)}
    folder = write_bundle(tmp_path / "broken", broken, operators=operators)
    with pytest.raises(BundleError, match=r"cannot load decoder\.onnx"):
        verify_bundle(folder)
