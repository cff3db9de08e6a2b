"""Break the runtime on purpose and see which tests notice: `python tests/faults/run.py [WORDS]`.

Each fault of `faults.py` is applied to a temporary copy of the working tree, and the tests that it names run there, in
a child process that is forked after the large packages are loaded. The exit code is 1 if a fault goes unnoticed, and 2
if the text of one is not there any more, or its tests fail without it.

    WORDS    only faults whose description has one of these words
"""

from __future__ import annotations

import contextlib
import importlib
import os
import shlex
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("runtime", "tests", "pyproject.toml")
PRELOADED = ("numpy", "onnxruntime", "tokenizers", "spacy.lang.en", "pytest", "hypothesis.strategies", "psutil")
EXIT_FAILED = 1
"""Exit code of pytest if tests failed."""

sys.path.insert(0, str(Path(__file__).parent))
from faults import FAULTS, Fault


@dataclass(frozen=True)
class Outcome:
    """What the tests said of one fault."""

    fault: Fault
    noticed_by: tuple[str, ...]
    """Names of the tests that failed."""
    seconds: float
    note: str = ""


def copy_tree(folder: Path) -> None:
    """Copy what the tests need; the bundle's files are linked, as nothing writes into them."""
    for part in PARTS:
        if (ROOT / part).is_dir():
            shutil.copytree(
                ROOT / part,
                folder / part,
                copy_function=_copy,
                ignore=shutil.ignore_patterns("__pycache__", ".pytest_cache", "*.egg-info"),
            )
        else:
            shutil.copy(ROOT / part, folder / part)


def _copy(source: str, target: str) -> None:
    if "bundles" in source:
        with contextlib.suppress(OSError):
            os.link(source, target)
            return
    shutil.copy2(source, target)


def apply(fault: Fault, folder: Path) -> str:
    """Break the copy; returns the text to restore.

    Raises:
        LookupError: the text is not there exactly once.
    """
    path = folder / "runtime" / "kinegraph" / fault.file
    text = path.read_text(encoding="utf-8")
    if text.count(fault.old) != 1:
        raise LookupError(f"{fault.what}: {fault.file} has its text {text.count(fault.old)} times; change the fault")
    changed = text.replace(fault.old, fault.new)
    if "_KEPT" in changed:
        changed = changed.replace("\n\n\n@dataclass", "\n\n_KEPT: list[object] = []\n\n\n@dataclass", 1)
    path.write_text(changed, encoding="utf-8")
    return text


def check_unbroken(faults: list[Fault], folder: Path) -> None:
    """Run all named tests on the copy as it is, those of one file together.

    Raises:
        LookupError: one fails without a fault, so that it proves nothing, or a name matches none.
    """
    names: dict[str, set[str]] = {}
    for fault in faults:
        files, _, name = fault.tests.partition(" -k ")
        names.setdefault(files, set()).add(f"({name.strip(chr(39))})" if name else "")
    for files, chosen in names.items():
        tests = files if "" in chosen else f"{files} -k '{' or '.join(sorted(chosen))}'"
        code, failed = run_tests(tests, folder)
        if code:
            raise LookupError(f"{tests}: fails without a fault ({', '.join(failed)})")


def run_tests(tests: str, folder: Path) -> tuple[int, tuple[str, ...]]:
    """Run tests in a forked child; returns pytest's exit code and the tests that failed."""
    log = folder / "log"
    child = os.fork()
    if child == 0:
        try:
            os._exit(_in_child(tests, folder, log))
        finally:
            os._exit(70)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    failed = [line.split(" ")[1].split("::")[-1] for line in lines if line.startswith(("FAILED ", "ERROR "))]
    return code, tuple(failed) or (lines[-1],) if code else ()


def _in_child(tests: str, folder: Path, log: Path) -> int:
    import pytest

    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    os.chdir(folder)
    paths = [str(folder / "runtime"), str(folder / "tests")]
    sys.path[:0] = paths
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    sys.dont_write_bytecode = True
    arguments = shlex.split(tests)
    files = [f"tests/{part}" if part.endswith(".py") else part for part in arguments]
    options = [
        "-x",
        "-q",
        "-p",
        "no:randomly",
        "--timeout=120",
        "--basetemp",
        str(folder / "temporary"),
    ]
    return int(pytest.main([*options, *files]))


def main(words: list[str]) -> int:
    """Apply all faults, one after another, and print a table."""
    for name in PRELOADED:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    chosen = [fault for fault in FAULTS if not words or any(word in fault.what for word in words)]
    outcomes = []
    with tempfile.TemporaryDirectory(prefix="kinegraph-faults-") as name:
        folder = Path(name)
        copy_tree(folder)
        for fault in chosen:  # before any test runs
            restore = apply(fault, folder)
            (folder / "runtime" / "kinegraph" / fault.file).write_text(restore, encoding="utf-8")
        check_unbroken(chosen, folder)
        for fault in chosen:
            start = time.monotonic()
            restore = apply(fault, folder)
            code, failed = run_tests(fault.tests, folder)
            (folder / "runtime" / "kinegraph" / fault.file).write_text(restore, encoding="utf-8")
            note = {0: "NOT NOTICED", EXIT_FAILED: "noticed"}.get(code, f"NO RESULT (pytest ended with {code})")
            outcomes.append(Outcome(fault, failed, time.monotonic() - start, note))
            print(f"| {fault.promise} | {fault.what} | {note} | {', '.join(failed[:2])} |", flush=True)
    noticed = sum(outcome.note == "noticed" for outcome in outcomes)
    print(f"{noticed} of {len(outcomes)} faults are noticed")
    return 0 if noticed == len(outcomes) else 1


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except LookupError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
