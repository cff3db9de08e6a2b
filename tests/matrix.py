"""Run chosen tests with the lowest and the newest of what pyproject.toml claims: `python tests/matrix.py`.

    --short        the short forms of the promises (default: memory over 1,000 clips, too)
    --tests ...    other tests, below tests/
    --keep FOLDER  keep the environments there and use them again

Each row is a fresh virtual environment: the oldest Python that is claimed with the lower bound of every package, and
with the newest of everything; and the newest Python that is on this machine, with the newest of everything. Needs pip
and its index. The exit code is 1 if a row fails; then pyproject.toml claims too much.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SHOWN = ("onnxruntime", "numpy", "tokenizers", "spacy", "starlette", "uvicorn")
TESTING = ("pytest>=8.2", "pytest-randomly>=3.15", "pytest-timeout>=2.3", "pytest-xdist>=3.6", "hypothesis>=6.100",
           "psutil>=5.9", "hatchling>=1.25")  # fmt: skip
SELECTION = ("promises", "runtime/test_pipeline.py", "runtime/test_parser.py", "runtime/test_sessions.py",
             "runtime/test_tokens.py", "runtime/test_playground.py", "runtime/test_read.py")  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One environment."""

    python: Path
    version: str
    is_lowest: bool


def interpreters() -> dict[str, Path]:
    """Find the Pythons of this machine that the project claims: version -> program, oldest first."""
    claimed = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", line)]
    found: dict[str, Path] = {}
    for version in claimed:
        pyenv = sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python"))
        named = shutil.which(f"python{version}")
        for program in [*pyenv, *([Path(named)] if named else [])]:
            done = subprocess.run([program, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"],
                                  capture_output=True, text=True, check=False)  # fmt: skip
            if done.returncode == 0 and done.stdout.strip() == version:
                found.setdefault(version, program)
    return found


def rows() -> list[Row]:
    """List the environments: the oldest Python with both ends, the newest with the newest."""
    found = interpreters()
    if not found:
        sys.exit("no Python that pyproject.toml claims is on this machine")
    versions = [*found]
    oldest, newest = versions[0], versions[-1]
    first, last = found[oldest], found[newest]
    both = [Row(first, oldest, True), Row(first, oldest, False)]
    return both if newest == oldest else [*both, Row(last, newest, False)]


def build(row: Row, folder: Path) -> Path:
    """Make an environment with everything that the tests need; returns its Python."""
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    if not python.exists():
        subprocess.run([row.python, "-m", "venv", str(folder)], check=True)
        extras = PROJECT["optional-dependencies"]
        needs = [*PROJECT["dependencies"], *extras["text"], *extras["play"]]
        if row.is_lowest:
            needs = [re.sub(r">=([\d.]+).*", r"==\1", need) for need in needs]
        install = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        subprocess.run([*install, *needs, *TESTING], check=True)
    return python


def versions(python: Path) -> list[str]:
    code = f"from importlib.metadata import version; print(*map(version, {SHOWN!r}))"
    return subprocess.run([python, "-c", code], capture_output=True, text=True, check=True).stdout.split()


def run_tests(python: Path, tests: list[str], *, is_short: bool) -> tuple[int, str]:
    """Run the tests; returns pytest's exit code and its last line."""
    paths = [f"tests/{test}" for test in tests]
    path = os.pathsep.join(str(ROOT / part) for part in ("runtime", "tests", "benchmarks"))
    command = [
        python,
        "-m",
        "pytest",
        "-o",
        f"cache_dir={python.parent.parent / '.pytest_cache'}",
        "-p",
        "no:randomly",
        "-rfE",
        *paths,
    ]
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([*command, "--promises=short"], cwd=ROOT, env=environment, capture_output=True, text=True)
    output = done.stdout
    if done.returncode == 0 and not is_short:
        memory = ["tests/promises/test_flat_memory.py", "--promises=long", "-k", "any_length"]
        done = subprocess.run([*command[:7], *memory], cwd=ROOT, env=environment, capture_output=True, text=True)
        output += done.stdout
    print(output[-3000:], file=sys.stderr)
    counts = re.findall(r"^\d+ (?:passed|failed)[^\n]*|^=*\s*(\d+ (?:passed|failed)[^=\n]*)", output, re.MULTILINE)
    return done.returncode, ", ".join(filter(None, counts)) or ("passed" if done.returncode == 0 else "failed")


def main() -> int:
    """Build, run, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--tests", nargs="+", default=[*SELECTION])
    parser.add_argument("--keep", type=Path)
    args = parser.parse_args()
    print(f"| Python | {' | '.join(SHOWN)} | result |\n|{'---|' * (len(SHOWN) + 2)}", flush=True)
    worst = 0
    with tempfile.TemporaryDirectory(prefix="kinegraph-matrix-") as temporary:
        for row in rows():
            folder = (args.keep or Path(temporary)) / f"{row.version}-{'lowest' if row.is_lowest else 'newest'}"
            python = build(row, folder)
            code, result = run_tests(python, args.tests, is_short=args.short)
            worst = max(worst, code)
            print(f"| {row.version} | {' | '.join(versions(python))} | {result} |", flush=True)
    return min(worst, 1)


if __name__ == "__main__":
    sys.exit(main())
