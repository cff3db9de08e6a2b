"""Promise 3, inert data: nothing of a bundle or a clip is run, and operators are those that the manifest lists."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import kinegraph
from kinegraph.bundle.reader import text_files_folder
from kinegraph.bundle.verify import verify_bundle
from kinegraph.errors import BundleFormatError
from support.synthetic_bundle import bundle_files, field, filler_model, manifest_for, node, write_bundle

PACKAGE = Path(kinegraph.__file__).resolve().parent
GRAPHS = sorted(name for name in bundle_files() if name.endswith(".onnx"))

FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "runpy", "code", "codeop", "yaml"}
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__", "input"}
BY_NAME = {"__init__.py", "formats/__init__.py", "text/dependency.py"}
"""Modules that import by a name; the names are those of tables in the same file."""


def test_no_module_of_the_runtime_can_run_data() -> None:
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        where = path.relative_to(PACKAGE).as_posix()
        for part in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(part, ast.Import):
                found += [(where, name.name) for name in part.names if name.name.split(".")[0] in FORBIDDEN_MODULES]
            elif isinstance(part, ast.ImportFrom) and (part.module or "").split(".")[0] in FORBIDDEN_MODULES:
                found.append((where, str(part.module)))
            elif isinstance(part, ast.Call):
                name = ast.unparse(part.func)
                allowed = {keyword.arg: ast.unparse(keyword.value) for keyword in part.keywords}
                if (
                    name in FORBIDDEN_CALLS
                    or allowed.get("allow_pickle") == "True"
                    or name == "np.load"
                    or (name.endswith("import_module") and where not in BY_NAME)
                ):
                    found.append((where, name))
    assert found == []


HOSTILE = """
import io, json, os, sys
from pathlib import Path
import numpy as np
from kinegraph import KinegraphError, MotionPipeline
from kinegraph.bundle.manifest import decode_manifest, describe_file, encode_manifest
from kinegraph.formats import read
import dataclasses

good, folder = Path(sys.argv[1]), Path(sys.argv[2])
pipe = MotionPipeline.load(good, threads=1)
clip = pipe.generate(pipe.parse("a person walks"), seconds=1, seed=1, steps=1)
for suffix in (".npz", ".json", ".glb", ".bvh"):
    clip.save(folder / ("good" + suffix))
    read(folder / ("good" + suffix))

class Trap:
    def __reduce__(self):
        return os.system, ("touch " + str(folder / "executed"),)

def trap(**more):
    buffer = io.BytesIO()
    array = np.empty((1, 21), dtype=object)
    array[:] = Trap()
    np.savez(buffer, **{**{name: array for name in more.pop("names")}, **more})
    return buffer.getvalue()

import pickle, srsly
config = srsly.msgpack_loads((good / "parser.bin").read_bytes())
config["config.cfg"] = "[nlp]\\nlang = en\\n\\n[initialize]\\nbefore_init = {'@callbacks': 'os.system'}\\n"
config["meta"] = {**(config.get("meta") or {}), "lang": "en", "name": "owned"}
hostile = {
    "tables.npz": trap(names=["bone_lengths"]),
    "vocabulary.npz": trap(names=["facts", "embeddings"]),
    "arguments.npz": trap(names=["names", "weights", "provenance"]),
    "parser.bin": srsly.msgpack_dumps(config),
    "tokenizer.json": pickle.dumps(Trap()),
    "decoder.onnx": pickle.dumps(Trap()),
}
files = {path.name: path.read_bytes() for path in good.iterdir() if path.name != "manifest.json"}
manifest = decode_manifest((good / "manifest.json").read_bytes())
folders = {}
for name, data in hostile.items():
    (folder / name).mkdir()
    changed = {**files, name: data}
    for each, content in changed.items():
        (folder / name / each).write_bytes(content)
    sealed = dataclasses.replace(manifest, files={each: describe_file(content) for each, content in changed.items()})
    (folder / name / "manifest.json").write_bytes(encode_manifest(sealed))
clips = {"a.npz": trap(names=["joints"]), "b.npz": pickle.dumps(Trap()), "c.json": b"__import__('os').system('x')"}
for name, data in clips.items():
    (folder / name).write_bytes(data)

seen, packages = set(), {name.split(".")[0] for name in sys.modules}
def watch(event, arguments):
    if event in ("pickle.find_class", "os.system", "subprocess.Popen", "os.exec", "os.posix_spawn", "socket.connect"):
        seen.add(event)
    elif event == "exec":
        seen.add(f"exec {arguments[0].co_filename} {arguments[0].co_names[:8]}")
    elif event == "import" and arguments[0].split(".")[0] not in packages:
        seen.add("import " + arguments[0])
sys.addaudithook(watch)
MotionPipeline.load(good, threads=1).parse("a person walks and waves")
harmless = set(seen)  # spaCy builds classes from strings of its own

outcome = {}
for name in hostile:
    try:
        victim = MotionPipeline.load(folder / name, threads=1)
        graph = victim.parse("a person walks and waves")
        outcome[name] = "meta " + victim.parser()._dependency_parser._pipeline.meta.get("name", "")
        outcome[name] += " config " + str("before_init" in str(victim.parser()._dependency_parser._pipeline.config.get(
            "initialize", {}).get("before_init")))
    except KinegraphError as error:
        outcome[name] = type(error).__name__
for name in clips:
    try:
        read(folder / name)
    except KinegraphError as error:
        outcome[name] = type(error).__name__
print(json.dumps({"seen": sorted(seen - harmless), "outcome": outcome, "executed": (folder / "executed").exists()}))
"""


def test_hostile_data_runs_nothing(toy_bundle: Path, tmp_path: Path) -> None:
    pytest.importorskip("spacy")
    done = subprocess.run(
        [sys.executable, "-c", HOSTILE, str(toy_bundle), str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["seen"] == [] and not report["executed"]
    outcome = report["outcome"]
    assert "owned" not in outcome.pop("parser.bin"), "a bundle configures the parser"
    assert set(outcome.values()) <= {"BundleError", "BundleFormatError", "InvalidInputError"}, outcome


def test_a_parser_takes_weights_from_its_file_and_nothing_else(toy_bundle: Path) -> None:
    """Configuration and description in parser.bin are not read: they can name code to run."""
    srsly = pytest.importorskip("srsly")
    from kinegraph.text.dependency import load_pipeline

    data = (text_files_folder() / "parser.bin").read_bytes()
    content = srsly.msgpack_loads(data)
    content["config.cfg"] = '[nlp]\nlang = "en"\nbatch_size = 77\n'
    content["meta"] = {"lang": "en", "name": "somebody-else", "version": "6.6.6"}
    good, changed = load_pipeline(data), load_pipeline(srsly.msgpack_dumps(content))
    assert changed.config == good.config and changed.config["nlp"]["batch_size"] != 77
    assert changed.meta["name"] == good.meta["name"] != "somebody-else"


@pytest.mark.parametrize("name", GRAPHS)
def test_verify_refuses_an_operator_that_is_not_listed_in_any_graph(tmp_path: Path, name: str) -> None:
    whole = filler_model(manifest_for(bundle_files()).contracts[name.removesuffix(".onnx")])
    foreign = whole + field(7, field(1, node("Identity", ["unique"], ["spare"])))
    folder = write_bundle(tmp_path / "foreign", {**bundle_files(), name: foreign})
    with pytest.raises(BundleFormatError, match=rf"{name} uses the operator ai\.onnx::Identity"):
        verify_bundle(folder)


@pytest.mark.parametrize("data", [np.array([{}], dtype=object), np.array([print])])
def test_an_array_of_objects_is_no_array(tmp_path: Path, data: np.ndarray) -> None:
    from kinegraph import InvalidInputError
    from kinegraph.formats import read

    np.savez(tmp_path / "objects.npz", joints=data)
    with pytest.raises(InvalidInputError):
        read(tmp_path / "objects.npz")
