"""Check that the documents say what is there: links, options, names, versions."""

from __future__ import annotations

import argparse
import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

import kinegraph
from kinegraph.cli import _parser
from kinegraph.motion.skeleton import CONVENTIONS

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (
        *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")),
        *(ROOT / "docs").glob("*.md"),
        ROOT / "benchmarks" / "results" / "README.md",
        ROOT / "weights" / "README.md",
    )
)
MOST_WORDS = 1000
PACKAGES = {
    "kinegraph": "runtime",
    "kinegraph_training": "training",
    "kinegraph_export": "export",
    "kinegraph_benchmarks": "benchmarks",
}


def read(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def anchors(text: str) -> set[str]:
    """Fragments of the headings of a page, as code hosts make them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", read(page)):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, fragment = target.partition("#")
        file = (ROOT / page).parent / name if name else ROOT / page
        if not file.exists() or (fragment and fragment not in anchors(file.read_text(encoding="utf-8"))):
            broken.append(target)
    assert broken == []


def test_every_page_is_in_both_indexes() -> None:
    pages = {page.removeprefix("docs/") for page in PAGES if page.startswith("docs/")} - {"README.md"}
    for index, prefix in (("README.md", "docs/"), ("docs/README.md", "")):
        assert {page for page in pages if f"({prefix}{page})" not in read(index)} == set(), index


def test_every_picture_is_shown_somewhere() -> None:
    pictures = {
        path.name for path in (ROOT / "docs" / "pictures").iterdir() if path.suffix in (".png", ".jpg", ".gif", ".svg")
    }
    text = "".join(map(read, PAGES))
    assert {name for name in pictures if f"pictures/{name})" not in text} == set()


def test_the_readme_is_short_and_has_contents() -> None:
    text = read("README.md")
    assert len(text.split()) <= MOST_WORDS
    (contents,) = re.findall(r"^\*\*Contents:\*\*(.*?)\n\n", text, flags=re.DOTALL | re.MULTILINE)
    sections = [heading.lower().replace(" ", "-") for heading in re.findall(r"^## (.*)$", text, flags=re.MULTILINE)]
    assert re.findall(r"\(#([\w-]+)\)", contents) == sections


@pytest.mark.parametrize(
    ("page", "marker"),
    [("README.md", "first clip"), ("README.md", "tests"), ("README.md", "all tests"), ("docs/engines.md", "fbx")],
)
def test_markers_stand_before_one_command_each(page: str, marker: str) -> None:
    commands = re.findall(rf"^<!-- {marker} -->\n```sh\n(.+?)```$", read(page), flags=re.DOTALL | re.MULTILINE)
    assert len(commands) == 1


def test_modules_that_documents_name_are_there() -> None:
    missing = []
    for page in PAGES:
        if page == "CHANGELOG.md":
            continue  # names of the time
        text = read(page)
        for module in re.findall(r"python -m (kinegraph[\w.]*\w)\b(?!\.…)", text):
            file = ROOT / PACKAGES[module.partition(".")[0]] / module.replace(".", "/")
            if not (file.with_suffix(".py").is_file() or (file / "__main__.py").is_file()):
                missing.append(f"{page}: {module}")
    for name in re.findall(r"^\| `((?:quality|speed|ablations)\.\w+)", read("docs/evaluation.md"), flags=re.MULTILINE):
        if not (ROOT / "benchmarks" / "kinegraph_benchmarks" / f"{name.replace('.', '/')}.py").is_file():
            missing.append(f"docs/evaluation.md: {name}")
    assert missing == []


def test_the_table_of_equations_names_what_is_there() -> None:
    rows = re.findall(r"^\| [^|]+ \| `([\w/]+\.py)` \| ([^|]*) \|$", read("docs/architecture.md"), flags=re.MULTILINE)
    assert len(rows) > 15
    for file, names in rows:
        code = read(file)
        for name in re.findall(r"`(\w+)`", names):
            assert re.search(rf"^\s*(?:def|class) {name}\b|^{name}\b.*=", code, flags=re.MULTILINE), (file, name)


def commands() -> dict[str, argparse.ArgumentParser]:
    (verbs,) = (action for action in _parser()._actions if isinstance(action, argparse._SubParsersAction))
    return dict(verbs.choices)


def test_the_page_of_the_command_line_has_every_command_and_option() -> None:
    text = read("docs/cli.md")
    for command, parser in commands().items():
        assert f"`{command}`" in text
        for action in parser._actions:
            for option in action.option_strings:
                assert option in ("-h", "--help") or re.search(rf"{option}(?![\w-])", text), (command, option)


def test_options_of_the_page_are_options_of_the_program() -> None:
    known = {option for parser in commands().values() for action in parser._actions for option in action.option_strings}
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", read("docs/cli.md"))) <= known


def test_joint_names_of_the_page_are_those_of_the_files() -> None:
    rows = re.findall(r"^\| (\d+) \| `([\w:]+)` \| `([\w:]+)` \|$", read("docs/engines.md"), flags=re.MULTILINE)
    assert [(int(index), smpl, mixamo) for index, smpl, mixamo in rows] == [
        (index, *names) for index, names in enumerate(zip(CONVENTIONS["smpl"], CONVENTIONS["mixamo"], strict=True))
    ]


def test_the_changelog_knows_this_version() -> None:
    versions = re.findall(r"^## (\S+)(?: - (\d{4}-\d{2}-\d{2}))?$", read("CHANGELOG.md"), flags=re.MULTILINE)
    assert versions[0] == ("Unreleased", "")
    assert versions[1][0] == kinegraph.__version__
    assert all(date for _, date in versions[1:])


def test_the_script_of_the_pictures_imports_what_is_there() -> None:
    pytest.importorskip("uvicorn")
    script = ast.parse(read("docs/pictures/pages.py"))
    imports = [node for node in script.body if isinstance(node, ast.ImportFrom)]
    ours = [(str(node.module), name.name) for node in imports for name in node.names if "kinegraph" in str(node.module)]
    assert len(ours) > 4
    assert [name for module, name in ours if not hasattr(import_module(module), name)] == []
