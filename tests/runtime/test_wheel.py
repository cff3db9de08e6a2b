"""The wheel as it is built: typed, with the default bundle, and with nothing that does not belong into it."""

from __future__ import annotations

import configparser
import importlib
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from kinegraph.formats import WRITERS

pytest.importorskip("hatchling")
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=200)
    (path,) = folder.glob("kinegraph-*.whl")
    return zipfile.ZipFile(path)


def test_the_wheel_is_typed(wheel: zipfile.ZipFile) -> None:
    assert "kinegraph/py.typed" in wheel.namelist()


def test_the_wheel_carries_the_runtime_as_it_stands(wheel: zipfile.ZipFile) -> None:
    folder = ROOT / "runtime" / "kinegraph"
    sources = {
        f"kinegraph/{path.relative_to(folder).as_posix()}"
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    packed = {name for name in wheel.namelist() if name.startswith("kinegraph/")}
    assert packed == sources
    tops = {name.split("/")[0] for name in wheel.namelist()}
    assert {top for top in tops if not top.endswith(".dist-info")} == {
        "kinegraph",
        "kinegraph_export",
        "kinegraph_training",
    }


def test_pyinstaller_finds_the_hook_of_the_wheel(wheel: zipfile.ZipFile) -> None:
    (listed,) = (name for name in wheel.namelist() if name.endswith(".dist-info/entry_points.txt"))
    entry_points = configparser.ConfigParser()
    entry_points.read_string(wheel.read(listed).decode())
    module, function = entry_points["pyinstaller40"]["hook-dirs"].split(":")
    (folder,) = getattr(importlib.import_module(module), function)()
    hook = (Path(folder) / "hook-kinegraph.py").read_text(encoding="utf-8")
    assert "kinegraph/_pyinstaller/hook-kinegraph.py" in wheel.namelist()
    # what is imported by name only, and the files that no import shows
    assert {name.rpartition(".")[0] for name in WRITERS.values()} == {"kinegraph.formats"}
    assert 'collect_submodules("kinegraph.formats")' in hook and all(
        f'subdir="{name}"' in hook for name in ("bundles", "viewer")
    )
