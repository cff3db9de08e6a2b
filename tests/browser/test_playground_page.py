"""The playground in a browser: a sentence becomes a clip, coarse levels first; files; cancelling; links."""

from __future__ import annotations

import re
import threading
import time
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from kinegraph import cli
from kinegraph.clip import Clip
from kinegraph.playground.jobs import GenerationJob
from support.browsing import (
    TEXT,
    Open,
    changed,
    clips_shown,
    download,
    generate,
    picture_at,
    settings,
    time_of,
    wait_until,
)
from support.playground import PlaygroundClient

if TYPE_CHECKING:
    from playwright.sync_api import Page

LONG_STEPS = "900"


def test_a_sentence_becomes_a_clip_with_its_graph_and_its_latencies(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url)
    empty = page.locator("canvas").screenshot()
    start = time.monotonic()
    generate(page, seconds="3", seed="7")
    assert time.monotonic() - start < 10  # a safeguard only; benchmarks measure the promised time
    assert changed(empty, page.locator("canvas").screenshot()) > 0.01
    assert changed(picture_at(page, 0.5), picture_at(page, 2.0)) > 0.01
    assert page.locator(".graph .words").all_text_contents()[0] == "walks"
    assert "3.0 s, 60 frames" in page.locator(".facts").inner_text()
    assert page.locator(".clock").inner_text() == "2.0 / 3.0 s"
    stages = page.locator(".stages dt").all_text_contents()
    assert stages[0] == "parser" and stages[-1] == "clip seen after" and len(stages) in (8, 9)


def test_downloads_are_named_after_the_sentence_and_the_seed(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url)
    generate(page, seconds="2", seed="11", steps="2")
    with page.expect_download(timeout=60_000) as waiting:
        page.locator("[data-suffix='.bvh']").click()
    words = "_".join(re.findall(r"[a-z]+", TEXT.lower()))
    assert waiting.value.suggested_filename == f"{words}_11.bvh"


def test_files_are_those_of_the_command_line(open_page: Open, server: PlaygroundClient, tmp_path: Path) -> None:
    page = open_page(server.url)
    generate(page, seconds="2", seed="11", steps="4,4,5", guidance="2.0")
    flags = ["--seconds", "2", "--seed", "11", "--steps", "4,4,5", "--guidance", "2.0", "--threads", "1", "--quiet"]
    for suffix in (".bvh", ".glb", ".npz", ".html"):
        assert cli.main(["generate", TEXT, *flags, "-o", str(tmp_path / f"x{suffix}")]) == 0
        assert download(page, suffix) == (tmp_path / f"x{suffix}").read_bytes(), suffix
    page.get_by_label("Joint names").select_option("mixamo")
    assert cli.main(["generate", TEXT, *flags, "--names", "mixamo", "-o", str(tmp_path / "m.bvh")]) == 0
    assert download(page, ".bvh") == (tmp_path / "m.bvh").read_bytes()


@pytest.fixture
def go_on(monkeypatch: pytest.MonkeyPatch) -> threading.Semaphore:
    """Make generation wait after each sketch until this is released, however slowly the browser draws."""
    on_level, semaphore = GenerationJob._on_level, threading.Semaphore(0)

    def wait(self: GenerationJob, level: str, clip: Clip) -> None:
        on_level(self, level, clip)
        assert semaphore.acquire(timeout=60)

    monkeypatch.setattr(GenerationJob, "_on_level", wait)
    return semaphore


def test_coarse_motion_is_seen_first_from_the_same_place(
    open_page: Open, server: PlaygroundClient, go_on: threading.Semaphore
) -> None:
    page = open_page(server.url)
    empty = page.locator("canvas").screenshot()
    page.get_by_label("What should the person do?").fill(TEXT)
    settings(page, seconds="3", seed="1", steps="2")
    page.get_by_role("button", name="Generate").click()
    seen = []
    for level in ("whole motion", "actions"):
        wait_until(page, lambda level=level: page.locator(".panes").inner_text() == f"Sketch of the {level}")  # type: ignore[misc]
        assert clips_shown(page) == 0
        seen.append(page.locator("canvas").screenshot() if seen else picture_at(page, 1.5))
        assert time_of(page) == 1.5
        go_on.release()
    wait_until(page, lambda: clips_shown(page) == 1, 60)
    assert page.locator(".panes").inner_text() == "" and time_of(page) == 1.5
    # the body differs each time, the room stays the same
    seen.append(page.locator("canvas").screenshot())
    assert all(0.01 < changed(before, after) < 0.3 for before, after in pairwise([empty, *seen]))
    assert "sketch seen after" in (page.locator(".stages").text_content() or "")


@pytest.mark.parametrize("again", [False, True])
def test_cancelled_after_a_sketch_what_was_there_comes_back(
    open_page: Open, server: PlaygroundClient, again: bool
) -> None:
    page = open_page(server.url)
    if again:
        generate(page, seconds="3", seed="1", steps="2")
        before = picture_at(page, 1.5)
    else:
        before = page.locator("canvas").screenshot()
    settings(page, seconds="3", seed="2", steps="2,900,900")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: "Sketch" in page.locator(".panes").inner_text())
    page.get_by_role("button", name="Cancel").focus()
    page.keyboard.press("Enter")
    wait_until(page, lambda: page.locator(".panes").inner_text() == "")
    wait_until(page, lambda: page.evaluate("document.activeElement.innerText") == "Generate")
    page.wait_for_timeout(200)
    after = picture_at(page, 1.5) if again else page.locator("canvas").screenshot()
    assert changed(before, after) == 0
    assert clips_shown(page) == again and page.get_by_role("button", name="Keep beside").is_visible()


def test_what_is_wrong_is_said_and_the_page_goes_on(open_page: Open, server: PlaygroundClient) -> None:
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
    """Start a clip that takes long, and wait until it is being generated."""
    page.get_by_label("What should the person do?").fill(TEXT)
    settings(page, seconds="9.8", steps=LONG_STEPS)
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: "step" in page.locator(".status").inner_text())


@pytest.mark.parametrize("way", ["button", "key", "closed"])
def test_cancel_stops_the_clip(open_page: Open, server: PlaygroundClient, way: str) -> None:
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
        assert page.locator(".status").inner_text() == "" and clips_shown(page) == 0
        generate(page, seconds="1", steps="2")


def test_two_tabs_at_once(open_page: Open, server: PlaygroundClient) -> None:
    first, second = open_page(server.url), open_page(server.url)
    for page in (first, second):
        page.get_by_label("What should the person do?").fill(TEXT)
        settings(page, seconds="2", seed="5", steps="20")
    for page in (first, second):
        page.get_by_role("button", name="Generate").click()
    for page in (first, second):
        wait_until(page, lambda page=page: clips_shown(page) == 1)  # type: ignore[misc]
    assert download(first, ".bvh") == download(second, ".bvh")


def test_a_link_makes_the_clip_again(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url)
    generate(page, "a person walks slowly", seconds="1.5", steps="3")
    page.get_by_label("Weight of slowly").fill("0.5")
    wait_until(page, lambda: clips_shown(page) == 2)
    page.get_by_role("button", name="Link").click()
    wait_until(page, lambda: "#" in page.url)
    other = open_page(page.url)
    wait_until(other, lambda: clips_shown(other) == 1)
    assert other.get_by_label("Weight of slowly").input_value() == "0.5"
    assert download(other, ".npz") == download(page, ".npz")


def test_a_clip_is_kept_beside_the_next(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 480)
    generate(page, seconds="1", seed="1", steps="2")
    page.get_by_role("button", name="Keep beside").click()
    generate(page, seconds="1", seed="2", steps="2")
    assert page.locator("canvas").get_attribute("data-panes") == "2"
    assert page.locator(".panes p").all_text_contents() == [f"{TEXT}, seed 1", f"{TEXT}, seed 2"]
    page.get_by_label("Weight of to the left").fill("0.5")
    wait_until(page, lambda: clips_shown(page) == 3)
    assert page.locator(".panes p").all_text_contents()[1] == f"{TEXT}, to the left ×0.5, seed 2"
    page.get_by_role("button", name="Only this one").click()
    wait_until(page, lambda: page.locator("canvas").get_attribute("data-panes") == "1")
    assert changed(picture_at(page, 0.2), picture_at(page, 0.9)) > 0.001


def test_words_that_are_not_known_are_told_under_the_sentence_and_beside_the_clip(
    open_page: Open, server: PlaygroundClient
) -> None:
    page = open_page(server.url)
    field, told = page.get_by_label("What should the person do?"), page.locator("#told")
    assert not told.is_visible()
    field.fill("a person walks and juggles")
    wait_until(page, told.is_visible)
    assert told.locator("mark").all_text_contents() == ["juggles"]
    assert "Not known: juggles; near: “" in told.inner_text()  # in words, not by colour alone
    assert (
        page.locator("[role=status]").filter(has=told).count() == 1
        and field.get_attribute("aria-describedby") == "told"
    )
    generate(page, "a person walks and juggles", seconds="1", seed="1", steps="2")
    assert page.locator(".result .told mark").all_text_contents() == ["juggles"]
    field.fill("a person walks")
    wait_until(page, lambda: not told.is_visible())
    generate(page, "a person walks", seconds="1", seed="1", steps="2")
    wait_until(page, lambda: not page.locator(".result .told").is_visible())


def test_what_replaces_words_is_told_too(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url)
    generate(page, "two men walk", seconds="1", seed="1", steps="2")
    assert "two men (more than one person)" in page.locator("#told").inner_text()
    page.get_by_label("Other words for walk").click()
    page.get_by_label("Other words for walk").fill("swim")
    page.get_by_label("Other words for walk").press("Enter")
    wait_until(page, lambda: "swim" in page.locator("#told").inner_text())
