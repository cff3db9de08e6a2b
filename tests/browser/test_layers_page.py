"""Concepts over spans of the timeline of the playground: by mouse and by keyboard, as `timeline.generate_timeline`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING
from urllib.parse import urlencode

import pytest

from kinegraph import MotionPipeline
from kinegraph.formats import encode
from kinegraph.layers import Layer
from kinegraph.timeline import generate_timeline
from support.browsing import Open, clips_shown, download, wait_until
from support.playground import PlaygroundClient

if TYPE_CHECKING:
    from playwright.sync_api import Page

TEXTS = ["a person walks forward", "a person stands still"]
SCENE = "#" + urlencode({"texts": json.dumps(TEXTS), "seconds": "1,1", "seed": 3, "steps": 2})


@pytest.fixture(autouse=True)
def constrained(pipe: MotionPipeline) -> None:
    assert pipe.sampler.sessions.decoder_gradients


def bars(page: Page) -> list[str]:
    found: list[str] = page.locator(".bar-of").evaluate_all("bars => bars.map((bar) => bar.ariaLabel)")
    return found


def fill(page: Page, name: str, value: str) -> None:
    """Fill in a field of the concept and wait for its clip."""
    before = clips_shown(page)
    page.get_by_label(f"{name} of the concept").fill(value)
    page.get_by_label(f"{name} of the concept").press("Enter")
    wait_until(page, lambda: clips_shown(page) > before)


def test_a_concept_counts_for_the_sentences_that_it_touches(
    open_page: Open, server: PlaygroundClient, pipe: MotionPipeline
) -> None:
    page = open_page(server.url + SCENE, 900, 620)
    wait_until(page, lambda: clips_shown(page) == 1)
    page.get_by_role("button", name="Concept", exact=True).click()
    wait_until(page, lambda: clips_shown(page) == 2)
    assert bars(page) == ["waves the right hand from 0.0 to 1.0 s"]
    assert page.evaluate("document.activeElement.ariaLabel") == "Words of the concept"
    fill(page, "Words", "a person turns left")
    fill(page, "Weight", "-0.5")
    assert bars(page) == ["not turns left ×0.5 from 0.0 to 1.0 s"]
    # its end, with the mouse: a quarter of the timeline later
    box = page.locator(".bar-of").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] - 3, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + box["width"] / 2, y, steps=4)
    page.mouse.up()
    wait_until(page, lambda: clips_shown(page) == 5)
    (bar,) = bars(page)
    assert bar == "not turns left ×0.5 from 0.0 to 1.5 s; counts from 0.0 to 2.0 s"
    assert "counts from 0 to 2 s" in page.locator(".result .note").first.inner_text()
    layers = [Layer("a person turns left", 0, 1.5, -0.5)]
    clip = generate_timeline(pipe, TEXTS, seconds=1, seed=3, steps=2, layers=layers)
    assert download(page, ".npz") == encode(clip, ".npz")
    page.locator(".bar-of").focus()
    page.keyboard.press("Shift+ArrowLeft")
    wait_until(page, lambda: bars(page)[0].startswith("not turns left ×0.5 from 0.0 to 1.4 s"))
    page.keyboard.press("Delete")
    wait_until(page, lambda: bars(page) == [])
    assert page.evaluate("document.activeElement.innerText") == "Concept"
    page.get_by_role("button", name="Undo").click()
    wait_until(page, lambda: len(bars(page)) == 1)
    page.reload()
    page.wait_for_selector("html[data-shown]", state="attached")
    assert bars(page)[0].startswith("not turns left")


def test_nothing_is_offered_to_cut_where_a_sentence_would_be_too_short(
    open_page: Open, server: PlaygroundClient
) -> None:
    layer = {"text": "a person turns left", "begin": 0.5, "end": 1.5, "weight": 1}
    scene = {"texts": json.dumps(TEXTS), "seconds": "2,1", "seed": 3, "steps": 2, "layers": json.dumps([layer])}
    page = open_page(f"{server.url}#{urlencode(scene)}", 900, 620)
    wait_until(page, lambda: clips_shown(page) == 1)
    page.locator(".bar-of").click()
    assert "counts from 0.0 to 2.0 s" in page.locator(".inspector.layer").inner_text()
    assert page.get_by_role("button", name="Cut the sentences to its span").count() == 0


def test_sentences_are_cut_to_the_span_of_a_concept_and_keep_their_seeds(
    open_page: Open, server: PlaygroundClient, pipe: MotionPipeline
) -> None:
    layer = {"text": "a person turns left", "begin": 1, "end": 2, "weight": 1}
    scene = {"texts": json.dumps(TEXTS), "seconds": "3,1", "seed": 3, "steps": 2, "layers": json.dumps([layer])}
    page = open_page(f"{server.url}#{urlencode(scene)}", 900, 620)
    wait_until(page, lambda: clips_shown(page) == 1)
    assert bars(page) == ["turns left from 1.0 to 2.0 s; counts from 0.0 to 3.0 s"]
    page.locator(".bar-of").click()
    assert "counts from 0.0 to 3.0 s" in page.locator(".inspector.layer").inner_text()
    page.get_by_role("button", name="Cut the sentences to its span").click()
    wait_until(page, lambda: clips_shown(page) == 2)
    assert bars(page) == ["turns left from 1.0 to 2.0 s"]
    assert "counts from" not in page.locator(".inspector.layer").inner_text()
    offsets = [0, 2, 3, 1]  # what was there keeps its own
    texts = [*TEXTS[:1] * 3, TEXTS[1]]
    clip = generate_timeline(pipe, texts, seconds=1, seed=3, steps=2, layers=[Layer(**layer)], seed_offsets=offsets)
    assert download(page, ".npz") == encode(clip, ".npz")
