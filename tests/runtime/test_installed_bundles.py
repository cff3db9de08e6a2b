"""Bundles that are installed with the package: by name, with the files that read text lying once beside them."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from kinegraph.bundle import reader
from kinegraph.bundle.reader import SHARED_FILES, installed_bundles, read_bundle, text_files_folder
from kinegraph.bundle.verify import verify_bundle
from kinegraph.cli import main
from kinegraph.errors import BundleError, BundleIntegrityError
from support.synthetic_bundle import bundle_files, write_bundle

posix = pytest.mark.skipif(os.name != "posix", reason="needs links")


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of two installed bundles, "studio" and the default "open", that share tokenizer and parser."""
    folder = tmp_path / "bundles"
    (folder / "shared").mkdir(parents=True)
    for name in ("studio", "open"):
        write_bundle(folder / name, name=f"{name} bundle")
        for file in SHARED_FILES & set(bundle_files()):
            (folder / name / file).replace(folder / "shared" / file)
    monkeypatch.setattr(reader, "BUNDLES", folder)
    monkeypatch.setattr(reader, "DEFAULT_BUNDLE", folder / "open")
    return folder


def test_a_name_is_that_bundle_and_none_is_the_default(installed: Path, here: Path) -> None:
    assert installed_bundles() == {name: installed / name for name in ("open", "studio")}
    assert read_bundle("studio").manifest.name == "studio bundle"
    assert read_bundle(None).manifest.name == "open bundle"
    assert text_files_folder() == installed / "shared"
    # A folder here has no part in names: what a text means does not depend on where a process runs.
    write_bundle(here / "studio", name="mine")
    assert read_bundle("studio").manifest.name == "studio bundle"
    assert read_bundle("./studio").manifest.name == read_bundle(Path("studio")).manifest.name == "mine"
    write_bundle(here / "other", name="another")
    assert read_bundle("other").manifest.name == "another"


def test_an_unknown_name_tells_those_that_are_known(installed: Path, here: Path) -> None:
    for name in ("studios", "shared", "Studio"):
        with pytest.raises(BundleError, match="installed are: open, studio" if name != "shared" else "no bundle"):
            read_bundle(name)


def test_all_bytes_of_a_bundle_are_read_wherever_they_lie(installed: Path) -> None:
    files = read_bundle("studio").files
    assert {name: files[name] for name in ("tokenizer.json", "parser.bin")} == {
        name: bundle_files()[name] for name in ("tokenizer.json", "parser.bin")
    }
    assert len(verify_bundle("studio").files) == len(bundle_files())


@pytest.mark.usefixtures("no_sessions")
@pytest.mark.parametrize("name", ["tokenizer.json", "parser.bin"])
def test_a_shared_file_that_was_altered_or_is_gone_is_named(installed: Path, name: str) -> None:
    path = installed / "shared" / name
    good = path.read_bytes()
    path.write_bytes(bytes([good[0] ^ 1]) + good[1:])
    with pytest.raises(BundleIntegrityError, match=f"{name} differs"):
        verify_bundle("studio")
    path.unlink()
    with pytest.raises(BundleIntegrityError, match=f"{name} is missing"):
        verify_bundle("studio")


@posix
@pytest.mark.usefixtures("no_sessions")
def test_a_shared_file_or_folder_that_is_a_link_is_refused(installed: Path, tmp_path: Path) -> None:
    path = installed / "shared" / "parser.bin"
    path.rename(tmp_path / "parser.bin")
    path.symlink_to(tmp_path / "parser.bin")
    with pytest.raises(BundleIntegrityError, match=r"parser\.bin is a link"):
        verify_bundle("studio")
    path.unlink()
    (tmp_path / "parser.bin").rename(path)
    (installed / "shared").rename(tmp_path / "elsewhere")
    (installed / "shared").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(BundleIntegrityError, match="shared' is a link"):
        verify_bundle("studio")


def test_only_files_that_read_text_are_shared(installed: Path) -> None:
    (installed / "studio" / "decoder.onnx").replace(installed / "shared" / "decoder.onnx")
    with pytest.raises(BundleIntegrityError, match=r"decoder\.onnx is missing"):
        read_bundle("studio")


def test_a_bundle_anywhere_else_shares_nothing(installed: Path, tmp_path: Path) -> None:
    for name in ("studio", "shared"):
        shutil.copytree(installed / name, tmp_path / "elsewhere" / name)
    with pytest.raises(BundleIntegrityError, match=r"is missing .* copy what lies in 'shared' beside the original too"):
        read_bundle(tmp_path / "elsewhere" / "studio")
    (installed / "studio" / "decoder.onnx").unlink()
    with pytest.raises(BundleIntegrityError, match=r"decoder\.onnx is missing .*; fetch the bundle again$"):
        read_bundle("studio")


def test_a_file_of_its_own_goes_before_a_shared_one(installed: Path) -> None:
    shutil.copyfile(installed / "shared" / "parser.bin", installed / "studio" / "parser.bin")
    (installed / "shared" / "parser.bin").write_bytes(b"of a newer release")
    assert read_bundle("studio").files["parser.bin"] == bundle_files()["parser.bin"]


def test_info_lists_them_with_their_licences(installed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "--bundle", "studio"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("studio bundle") and "licences:" in text
    assert "open bundle 0.0.1; weights: CC0-1.0 (the default)" in text
    (installed / "open" / "manifest.json").write_bytes(b"{}")
    assert main(["info", "--bundle", "studio", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)["installed"]
    assert record["studio"] == {"default": False, "name": "studio bundle", "version": "0.0.1", "weights": "CC0-1.0"}
    assert record["open"]["default"] and "sha256" in record["open"]["error"]


@pytest.mark.parametrize("version", [2, 3])
def test_a_bundle_of_an_older_format_loads_with_its_own_file_names(tmp_path: Path, version: int) -> None:
    folder = write_bundle(tmp_path / "old", version=version)
    assert (folder / "clock_motion.onnx").is_file() and not (folder / "modulation_motion.onnx").exists()
    report = verify_bundle(folder)
    assert {"modulation_motion", "denoiser_specific", "denoiser_action_agd"} <= set(report.sessions)
