"""The page of clips: whole in one file, its own policy kept, no older than its sources, and `kinegraph view`."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import shutil
import subprocess
import webbrowser
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

import kinegraph
from kinegraph import cli
from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.formats import NAMED, READERS, encode
from kinegraph.formats.html import clips_page
from kinegraph.formats.npz import read_npz
from kinegraph.graph import SemanticGraph
from kinegraph.unknown import Unknown
from support.cli_runs import fails, whole
from support.motions import walk

PACKAGE = Path(kinegraph.__file__).resolve().parent
SOURCES = Path(__file__).resolve().parents[2] / "viewer"
"""Beside these tests, also where the package is installed."""
BUILT = {"page.html", "viewer.css", "viewer.js"}

# What a caption must not be able to do.
HOSTILE = "</script><script>alert(1)</script> {{script}} & \"'\u2028 走る"


def clip(frames: int = 20, text: str = "a person walks", graph: SemanticGraph | None = None) -> Clip:
    return Clip(walk(frames), 20.0, 2**60, text, "edge 1.2", graph)


class Page(HTMLParser):
    """Contents of scripts and styles, and every attribute."""

    def __init__(self, data: bytes) -> None:
        super().__init__()
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.styles: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.title = ""
        self._open: list[tuple[str, dict[str, str | None]]] = []
        self.feed(data.decode("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._open.append((tag, dict(attrs)))
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_data(self, data: str) -> None:
        tag, attributes = self._open[-1] if self._open else ("", {})
        if tag == "script":
            self.scripts.append((attributes, data))
        elif tag == "style":
            self.styles.append(data)
        elif tag == "title":
            self.title = data

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop()[0] != tag:
            pass

    @property
    def data(self) -> dict[str, list[dict[str, object]]]:
        (text,) = (text for attributes, text in self.scripts if attributes.get("type") == "application/json")
        found: dict[str, list[dict[str, object]]] = json.loads(text)
        return found

    @property
    def policy(self) -> str:
        (content,) = (
            value for tag, name, value in self.attributes if (tag, name) == ("meta", "content") and "src" in value
        )
        return content


def sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def test_the_page_holds_the_very_glb_and_what_was_asked_for() -> None:
    juggles = Unknown("juggles", 0, 7, ("bows",))
    notes = ("\u201ctwice\u201d is not counted",)
    own = replace(clip(text=HOSTILE, graph=whole("a person walks")), unknown=(juggles,), notes=notes)
    (shown,) = Page(encode(own, ".html")).data["clips"]
    assert gzip.decompress(base64.b64decode(str(shown.pop("glb")))) == encode(own, ".glb")
    graph = whole("a person walks").to_dict()
    assert shown == {
        "text": HOSTILE, "seed": str(2**60), "fps": 20.0, "frames": 20, "loops": False, "bundle": "edge 1.2",
        "graph": graph, "unknown": [juggles.to_dict()], "notes": list(notes), "misses": [],
    }  # fmt: skip


def test_several_clips_stand_in_one_page_in_their_order() -> None:
    texts = ["one", "two", "three"]
    found = Page(clips_page([clip(text=text) for text in texts]))
    assert [each["text"] for each in found.data["clips"]] == texts
    assert found.title == "one, two, three"


def test_nothing_comes_from_elsewhere_and_only_its_own_script_may_run() -> None:
    found = Page(encode(clip(text=HOSTILE), ".html"))
    links = [value for _, name, value in found.attributes if name in ("src", "href", "action", "srcset", "data")]
    assert links == ["data:,"]  # an icon of nothing, so that no browser asks for one
    scripts = [text for attributes, text in found.scripts if "type" not in attributes]
    (script,), (style,) = scripts, found.styles
    rules = dict(rule.strip().split(" ", 1) for rule in found.policy.split(";"))
    assert rules == {
        "default-src": "'none'",
        "script-src": f"'sha256-{sha256(script)}'",
        "style-src": f"'sha256-{sha256(style)}'",
        "img-src": "data: blob:",
        "connect-src": "'none'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }


def test_the_page_is_light_and_its_bytes_depend_on_the_clip_alone() -> None:
    longest = clip(196)
    assert len(clips_page([longest] * 4)) <= 1_500_000
    assert encode(clip(), ".html") == encode(clip(), ".html") != encode(clip(21), ".html")


def test_the_built_page_is_that_of_the_sources() -> None:
    if not SOURCES.is_dir():
        pytest.skip("the sources of the page are not here")
    built = hashlib.sha256()
    names = ["build.mjs", "package.json", "package-lock.json"]
    names += [f"src/{path.name}" for path in sorted((SOURCES / "src").iterdir())]
    for name in names:
        built.update(name.encode() + b"\0" + (SOURCES / name).read_bytes() + b"\0")
    script = (PACKAGE / "viewer" / "viewer.js").read_text(encoding="utf-8")
    assert f"sources sha256 {built.hexdigest()}" in script[:200], "run `npm ci && npm run build` in viewer/"


def test_the_script_keeps_the_notice_of_three() -> None:
    head = (PACKAGE / "viewer" / "viewer.js").read_text(encoding="utf-8")[:2000]
    assert "three.js" in head and "The MIT License" in head and "The above copyright notice and this permission" in head


def test_the_package_has_the_built_page_and_nothing_it_was_built_from() -> None:
    # `test_wheel` holds the wheel to the package's files.
    assert {path.name for path in (PACKAGE / "viewer").rglob("*")} == BUILT


def test_a_graph_travels_with_its_clip(tmp_path: Path) -> None:
    graph = whole("a person „walks“")
    clip(graph=graph).save(tmp_path / "with.npz")
    assert read_npz(tmp_path / "with.npz").graph == graph
    clip().save(tmp_path / "without.npz")
    assert read_npz(tmp_path / "without.npz").graph is None
    assert clip(graph=graph).in_place().graph == graph
    with pytest.raises(InvalidInputError, match="graph is of type dict"):
        Clip(walk(3), 20.0, 1, "x", "b", graph.to_dict())  # type: ignore[arg-type]


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    urls: list[str] = []
    monkeypatch.setattr(webbrowser, "open", urls.append)
    return urls


def test_view_opens_a_page_of_all_clips(here: Path, opened: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one", "two"):
        clip(text=name).save(here / f"{name}.npz")
    assert cli.main(["view", "one.npz", "two.npz"]) == 0
    written = Path(capsys.readouterr().out.strip())
    assert opened == [written.as_uri()] and here not in written.parents
    assert [each["text"] for each in Page(written.read_bytes()).data["clips"]] == ["one", "two"]
    assert cli.main(["view", "one.npz", "-o", "kept.html", "--no-browser"]) == 0
    assert len(opened) == 1
    assert (here / "kept.html").read_bytes() == encode(read_npz(here / "one.npz"), ".html")


def test_view_opens_every_format_that_holds_a_clip(here: Path, opened: list[str]) -> None:
    for suffix in READERS:
        for root in (False, True) if suffix in NAMED else (False,):
            names = "mixamo" if root else "smpl"
            clip(text=suffix).save(here / f"{suffix[1:]}{'_root' if root else ''}{suffix}", names=names, root=root)
    files = sorted(path.name for path in here.iterdir())
    assert cli.main(["view", *files, "-o", "page.html"]) == 0 and len(opened) == 1
    shown = Page((here / "page.html").read_bytes()).data["clips"]
    assert [each["text"] for each in shown] == ["bvh", "bvh_root", ".glb", ".glb", ".json", ".npz"]
    assert {(each["frames"], each["fps"]) for each in shown} == {(20, 20.0)}
    assert [each["seed"] for each in shown] == ["0", "0", *[str(2**60)] * 4]


def test_view_refuses_what_it_cannot_show(here: Path, opened: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    clip().save(here / "one.npz")
    (here / "two.npz").write_text("no clip")
    assert "no file 'none.npz'" in fails(capsys, "view", "none.npz")
    assert "'two.npz' is no clip" in fails(capsys, "view", "one.npz", "two.npz")
    (here / "two.glb").write_bytes(b"glTF of another program")
    assert "'two.glb' is no clip that kinegraph saved as .glb" in fails(capsys, "view", "one.npz", "two.glb")
    assert "clips are read from .bvh, .glb, .json, .npz" in fails(capsys, "view", "two.fbx")
    assert "can be saved as .html" in fails(capsys, "view", "one.npz", "-o", "page.pdf")
    (here / "page.html").write_text("mine")
    assert "exists" in fails(capsys, "view", "one.npz", "-o", "page.html")
    assert (here / "page.html").read_text() == "mine" and opened == []


def test_modules_of_the_page_pass_their_own_tests() -> None:
    node = shutil.which("node")
    if node is None or not (SOURCES / "tests").is_dir():
        pytest.skip("needs node, and the sources of the page")
    files = sorted(map(str, (SOURCES / "tests").glob("*.test.mjs")))
    found = subprocess.run([node, "--test", *files], capture_output=True, text=True, timeout=120)
    assert found.returncode == 0 and len(files) >= 5, found.stdout[-3000:]
