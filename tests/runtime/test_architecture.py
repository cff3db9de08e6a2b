"""The shape of the code: files that one clip passes through, circles of imports, modules too small to stand alone."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import kinegraph
from kinegraph import MotionPipeline
from kinegraph.bench import GRAPH

PACKAGES = ("kinegraph", "kinegraph_training", "kinegraph_export")
RUNTIME = str(Path(kinegraph.__file__).resolve().parent)
ONE_STEP = {"seconds": 1, "seed": 1, "steps": 1}

MOST_FILES = 25
SMALL = 40
"""Lines."""

SMALL_MODULES: dict[str, str] = {}
"""Modules of fewer lines that only one other imports -> why they are files of their own."""


def files_visited(call: Callable[[], Any]) -> set[str]:
    """The project's files in which a Python function runs during `call`."""
    visited: set[str] = set()

    def profile(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(RUNTIME):
            visited.add(frame.f_code.co_filename)

    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
    return {str(Path(name).relative_to(RUNTIME)) for name in visited}


@pytest.mark.parametrize("text", ["a person walks slowly to the left", GRAPH], ids=["sentence", "graph"])
def test_one_clip_passes_through_few_files(toy: MotionPipeline, text: Any, figure: Callable[[str], None]) -> None:
    visited = files_visited(lambda: toy.generate(text, **ONE_STEP))
    kind = "a sentence" if isinstance(text, str) else "a graph"
    figure(f"one clip of {kind} runs in {len(visited)} files of the project (limit {MOST_FILES})")
    assert len(visited) <= MOST_FILES, "\n".join(sorted(visited))


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """Module -> modules of the project that it imports, when it is imported or later; not for type checkers alone."""
    grimp = pytest.importorskip("grimp", reason="needs import-linter, of the extra dev")
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    return {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}


def source_file(module: str) -> Path:
    """The file of an installed module, found without importing it."""
    root, *rest = module.split(".")
    package = find_spec(root)
    assert package is not None and package.origin is not None
    path = Path(package.origin).parent.joinpath(*rest)
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected components of more than one module (Tarjan, 1972)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    components: list[list[str]] = []

    def visit(node: str) -> None:
        order[node] = low[node] = len(order)
        stack.append(node)
        for successor in edges[node]:
            if successor not in order:
                visit(successor)
                low[node] = min(low[node], low[successor])
            elif successor in stack:
                low[node] = min(low[node], order[successor])
        if low[node] == order[node]:
            component = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(component) > 1:
                components.append(sorted(component))

    for node in edges:
        if node not in order:
            visit(node)
    return components


def test_a_circle_is_found_and_a_chain_is_none() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]


def test_no_modules_import_one_another_in_a_circle(imports: dict[str, set[str]]) -> None:
    assert circles(imports) == []


def test_a_small_module_has_several_users_or_a_reason(imports: dict[str, set[str]]) -> None:
    lines = {module: source_file(module).read_text(encoding="utf-8").count("\n") for module in imports}
    users = {module: sum(module in imported for imported in imports.values()) for module in imports}
    small = {module for module in imports if users[module] == 1 and 1 < lines[module] < SMALL}
    assert small == set(SMALL_MODULES)
