"""The playground in a browser: sentence in, clip on the screen, sliders that move it, the command line's files."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browsing import Open, changed, shown, wait_until
from playing import Playing

from kinegraph import cli

pytest.importorskip("spacy")
pytest.importorskip("uvicorn")

if TYPE_CHECKING:
    from playwright.sync_api import Page

TEXT = "a person walks forward and turns to the left"
LONG_STEPS = "900"


def settings(page: Page, **values: str) -> None:
    """Fill in length, seed, guidance and steps."""
    if not page.get_by_label("Seconds").is_visible():
        page.get_by_text("Length, seed, steps").click()
    for name, value in values.items():
        page.get_by_label(name.capitalize()).fill(value)


def made(page: Page) -> int:
    return int(page.locator("html").get_attribute("data-made") or 0)


def generate(page: Page, text: str = TEXT, **values: str) -> None:
    """Ask for a clip and wait until it is there."""
    before = made(page)
    page.get_by_label("What should the person do?").fill(text)
    settings(page, **values)
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: made(page) > before)


def download(page: Page, suffix: str) -> bytes:
    with page.expect_download(timeout=60_000) as waiting:
        page.locator(f"[data-suffix='{suffix}']").click()
    assert waiting.value.suggested_filename == f"clip{suffix}"
    return Path(waiting.value.path()).read_bytes()


def test_a_sentence_becomes_a_clip_with_its_graph_and_its_latencies(open_page: Open, server: Playing) -> None:
    page = open_page(server.url)
    empty = page.locator("canvas").screenshot()
    start = time.monotonic()
    generate(page, seconds="3", seed="7")
    assert time.monotonic() - start < 10  # a guard: what is promised is measured by benchmarks
    assert changed(empty, page.locator("canvas").screenshot()) > 0.01
    assert changed(shown(page, 0.5), shown(page, 2.0)) > 0.01
    assert page.locator(".graph .words").all_text_contents()[0] == "walks"
    assert "3.0 s, 60 frames" in page.locator(".facts").inner_text()
    stages = ["parser", "text and motion", "previews", "action", "specific", "decoder, feet", "body", "until seen"]
    assert page.locator(".stages dt").all_text_contents() == stages


def test_files_are_those_of_the_command_line(open_page: Open, server: Playing, tmp_path: Path) -> None:
    page = open_page(server.url)
    generate(page, seconds="2", seed="11", steps="4,4,5", guidance="2.0")
    flags = ["--seconds", "2", "--seed", "11", "--steps", "4,4,5", "--guidance", "2.0", "--threads", "1", "--quiet"]
    for suffix in (".bvh", ".glb", ".npz", ".html"):
        assert cli.main(["generate", TEXT, *flags, "-o", str(tmp_path / f"x{suffix}")]) == 0
        assert download(page, suffix) == (tmp_path / f"x{suffix}").read_bytes(), suffix
    page.get_by_label("Joint names").select_option("mixamo")
    assert cli.main(["generate", TEXT, *flags, "--names", "mixamo", "-o", str(tmp_path / "m.bvh")]) == 0
    assert download(page, ".bvh") == (tmp_path / "m.bvh").read_bytes()


def test_a_slider_changes_the_motion_and_keeps_the_seed(open_page: Open, server: Playing, tmp_path: Path) -> None:
    page = open_page(server.url)
    generate(page, "a person walks and turns to the left", seconds="3", steps="6")  # the seed is drawn
    before, facts = shown(page, 2.5), page.locator(".facts").inner_text()
    page.get_by_label("Weight of to the left").fill("0")
    wait_until(page, lambda: made(page) == 2)
    assert page.locator(".facts").inner_text() == facts
    assert changed(before, shown(page, 2.5)) > 0.01
    seed = facts.split("seed ")[1].split(",")[0]
    flags = ["--weight", "to the left=0", "--seconds", "3", "--steps", "6", "--seed", seed, "--threads", "1", "--quiet"]
    assert cli.main(["generate", "a person walks and turns to the left", *flags, "-o", str(tmp_path / "x.npz")]) == 0
    assert download(page, ".npz") == (tmp_path / "x.npz").read_bytes()
    page.get_by_role("button", name="As parsed").click()
    wait_until(page, lambda: made(page) == 3)
    assert changed(before, shown(page, 2.5)) == 0


def test_the_graph_is_edited(open_page: Open, server: Playing) -> None:
    page = open_page(server.url)
    generate(page, "a person walks slowly", seconds="1", seed="1", steps="2")
    page.get_by_label("Delete slowly").click()
    wait_until(page, lambda: made(page) == 2)
    page.get_by_label("Hide the words walks").click()
    wait_until(page, lambda: made(page) == 3)
    page.get_by_text("Add a detail").click()
    page.get_by_label("Kind of detail").select_option("ARGM-DIR")
    page.get_by_label("Words", exact=True).first.fill("to the right")
    page.get_by_role("button", name="Add", exact=True).first.click()
    wait_until(page, lambda: made(page) == 4)
    page.get_by_text("Add an action").click()
    page.get_by_label("Words", exact=True).last.fill("waves")
    page.get_by_label("Words", exact=True).last.press("Enter")
    wait_until(page, lambda: made(page) == 5)
    assert page.locator(".graph .caption").inner_text() == "a person hidden to the right and waves"
    assert page.get_by_label("Delete waves").count() == 1


def test_what_is_wrong_is_said_and_the_page_goes_on(open_page: Open, server: Playing) -> None:
    page = open_page(server.url, refused=True)
    generate(page, seconds="1", seed="1", steps="2")
    for name, value in (("seconds", "90"), ("steps", "many"), ("guidance", "-3"), ("seed", "1.5")):
        settings(page, **{name: value})
        page.get_by_role("button", name="Generate").click()
        wait_until(page, lambda name=name: name in page.get_by_role("alert").inner_text())  # type: ignore[misc]
        settings(page, **{name: "1"})
    generate(page, seconds="1", steps="2", guidance="2")
    assert not page.get_by_role("alert").is_visible()


def long_run(page: Page) -> None:
    """Start a clip that would take long, and wait until it is under way."""
    page.get_by_label("What should the person do?").fill(TEXT)
    settings(page, seconds="9.8", steps=LONG_STEPS)
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: "step" in page.locator(".status").inner_text())


@pytest.mark.parametrize("way", ["button", "key", "closed"])
def test_cancel_stops_the_clip(open_page: Open, server: Playing, way: str) -> None:
    page = open_page(server.url)
    long_run(page)
    if way == "button":
        page.get_by_role("button", name="Cancel").click()
    elif way == "key":
        page.locator("body").press("Escape")
    else:
        page.close()
    start = time.monotonic()
    assert server.clip({"text": TEXT, "seconds": 1, "steps": 1}, tab="other")[-1]["event"] == "clip"
    assert time.monotonic() - start < 3
    if way != "closed":
        assert not page.get_by_role("button", name="Cancel").is_visible()
        assert page.locator(".status").inner_text() == "" and made(page) == 0
        generate(page, seconds="1", steps="2")


def test_two_tabs_at_once(open_page: Open, server: Playing) -> None:
    first, second = open_page(server.url), open_page(server.url)
    for page in (first, second):
        page.get_by_label("What should the person do?").fill(TEXT)
        settings(page, seconds="2", seed="5", steps="20")
    for page in (first, second):
        page.get_by_role("button", name="Generate").click()
    for page in (first, second):
        wait_until(page, lambda page=page: made(page) == 1)  # type: ignore[misc]
    assert download(first, ".bvh") == download(second, ".bvh")


def test_a_link_makes_the_clip_again_and_runs_nothing_by_itself(open_page: Open, server: Playing) -> None:
    page = open_page(server.url)
    generate(page, "a person walks slowly", seconds="1.5", steps="3")
    page.get_by_label("Weight of slowly").fill("0.5")
    wait_until(page, lambda: made(page) == 2)
    page.get_by_role("button", name="Link").click()
    wait_until(page, lambda: "#" in page.url)
    other = open_page(page.url)
    other.wait_for_timeout(500)
    assert made(other) == 0
    assert other.get_by_label("Weight of slowly").input_value() == "0.5"
    other.get_by_role("button", name="Generate").click()
    wait_until(other, lambda: made(other) == 1)
    assert download(other, ".npz") == download(page, ".npz")


def test_concepts_are_composed(open_page: Open, server: Playing, tmp_path: Path) -> None:
    page = open_page(server.url)
    page.get_by_label("Concepts").check()
    page.get_by_role("button", name="Add a concept").click()
    page.get_by_label("Concept", exact=True).last.fill("a person runs")
    page.get_by_label("Weight").last.fill("-0.5")
    assert page.locator(".rows output").last.inner_text() == "not ×0.5"
    page.get_by_label("Method").select_option("latent")
    settings(page, seconds="2", seed="3", steps="3")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: made(page) == 1)
    words = ["--and", "a person walks forward", "--and", "a person waves the right hand", "--not", "a person runs:0.5"]
    flags = ["--method", "latent", "--seconds", "2", "--seed", "3", "--steps", "3", "--threads", "1", "--quiet"]
    assert cli.main(["compose", *words, *flags, "-o", str(tmp_path / "x.npz")]) == 0
    assert download(page, ".npz") == (tmp_path / "x.npz").read_bytes()


def test_a_clip_is_kept_beside_the_next(open_page: Open, server: Playing) -> None:
    page = open_page(server.url, 900, 480)
    generate(page, seconds="1", seed="1", steps="2")
    page.get_by_role("button", name="Keep beside").click()
    generate(page, seconds="1", seed="2", steps="2")
    assert page.locator("canvas").get_attribute("data-panes") == "2"
    assert page.locator(".panes p").all_text_contents() == [f"{TEXT}, seed 1", f"{TEXT}, seed 2"]
    page.get_by_role("button", name="Only this one").click()
    wait_until(page, lambda: page.locator("canvas").get_attribute("data-panes") == "1")
    assert changed(shown(page, 0.2), shown(page, 0.9)) > 0.001


def test_the_coarse_motion_is_seen_first(open_page: Open, server: Playing) -> None:
    page = open_page(server.url)
    empty = page.locator("canvas").screenshot()
    page.get_by_label("What should the person do?").fill(TEXT)
    settings(page, seconds="3", seed="1", steps="2,2,900")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: "so far the actions" in page.locator(".panes").inner_text())
    assert made(page) == 0
    assert changed(empty, page.locator("canvas").screenshot()) > 0.01
    wait_until(page, lambda: made(page) == 1, 60)
    assert page.locator(".panes").inner_text() == ""


LABELS = """() => [...document.querySelectorAll("button, input, select, textarea, summary, canvas")]
  .filter((one) => one.checkVisibility())
  .filter((one) => !(one.ariaLabel || one.innerText?.trim() || one.labels?.length))
  .map((one) => one.outerHTML)"""

# WCAG 2.2, relative luminance and contrast ratio, of every element that shows text of its own
CONTRASTS = """() => {
  const channels = (text) => (text.match(/[\\d.]+/g) ?? []).map(Number);
  const lightness = ([r, g, b]) => {
    const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
    const [x, y, z] = [r, g, b].map((c) => linear(c / 255));
    return 0.2126 * x + 0.7152 * y + 0.0722 * z;
  };
  const ground = (one) => {
    for (; one; one = one.parentElement) {
      const colour = channels(getComputedStyle(one).backgroundColor);
      if (colour.length === 3 || colour[3] > 0) return colour;
    }
    return [255, 255, 255];
  };
  return [...document.querySelectorAll("body *")]
    .filter((one) => one.checkVisibility() && [...one.childNodes].some((n) => n.nodeType === 3 && n.data.trim()))
    .filter((one) => !["SCRIPT", "STYLE", "OPTION", "NOSCRIPT"].includes(one.tagName))
    .map((one) => {
      const [a, b] = [channels(getComputedStyle(one).color), ground(one)].map(lightness).sort((p, q) => q - p);
      return [one.className || one.tagName, one.innerText, (a + 0.05) / (b + 0.05)];
    });
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_labels_contrast_and_width(open_page: Open, server: Playing, scheme: str, width: int, height: int) -> None:
    page = open_page(server.url, width, height, color_scheme=scheme)
    generate(page, seconds="1", seed="1", steps="2")
    assert page.evaluate(LABELS) == []
    contrasts = page.evaluate(CONTRASTS)
    assert len(contrasts) > 20
    assert [each for each in contrasts if each[2] < 4.5] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_focus_goes_from_the_sentence_to_the_button_and_on(open_page: Open, server: Playing) -> None:
    page = open_page(server.url, 1280, 800)
    seen = []
    for _ in range(4):
        seen.append(page.evaluate("document.activeElement.id || document.activeElement.innerText"))
        page.keyboard.press("Tab")
    assert seen[:3] == ["text", "Length, seed, steps", "Generate"]
    page.get_by_label("What should the person do?").focus()
    page.keyboard.press("Enter")
    wait_until(page, lambda: made(page) == 1)
