"""The timeline of the playground: sentences one after another, by mouse and by keyboard, as `kinegraph sequence`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from kinegraph import cli
from support.browsing import Open, clips_shown, download, generate, settings, shows, time_of, wait_until
from support.playground import PlaygroundClient

if TYPE_CHECKING:
    from playwright.sync_api import Page

SEED = ["--seed", "3", "--steps", "2", "--threads", "1", "--quiet"]


def segments(page: Page) -> list[str]:
    """Words and lengths of all segments."""
    return [" ".join(text.split()) for text in page.locator(".segment").all_inner_texts()]


def begin(open_page: Open, server: PlaygroundClient) -> Page:
    page = open_page(server.url, 900, 620)
    generate(page, "a person walks", seconds="2", seed="3", steps="2")
    return page


def seed_of(page: Page) -> str:
    """The seed of the clip that is seen, as the page tells it."""
    found = re.search(r"seed (\d+)", page.locator(".facts").inner_text())
    assert found is not None
    return found[1]


def wait_made(page: Page, count: int) -> None:
    wait_until(page, lambda: clips_shown(page) >= count)


def test_three_sentences_follow_one_another(open_page: Open, server: PlaygroundClient, tmp_path: Path) -> None:
    page = begin(open_page, server)
    for count, text in ((2, "a person bows"), (4, "a person waves both hands")):
        page.get_by_role("button", name="+ Sentence").click()
        wait_made(page, count)
        page.get_by_label("What should the person do?").fill(text)
        page.get_by_role("button", name="Generate").click()
        wait_made(page, count + 1)
    assert segments(page) == ["walks 2.0 s", "bows 2.0 s", "waves both hands 2.0 s"]
    texts = ["a person walks", "a person bows", "a person waves both hands"]
    assert cli.main(["sequence", *texts, "--seconds", "2,2,2", *SEED, "-o", str(tmp_path / "x.npz")]) == 0
    name = "a_person_walks_then_a_person_bows_then_a_person_waves_both_3.npz"
    assert download(page, ".npz", name) == (tmp_path / "x.npz").read_bytes()
    assert page.locator(".facts").inner_text().endswith("made anew: sentence 3 of 3")  # the others were known
    assert page.locator(".segment.fresh").count() == 1
    # another is selected, and its words go into the form; nothing is made for that
    page.get_by_label(re.compile("^Segment 2 of 3")).click()
    assert page.get_by_label("What should the person do?").input_value() == "a person bows"
    assert page.locator(".segment[aria-pressed=true]").inner_text().startswith("bows")
    assert clips_shown(page) == 5
    page.get_by_role("button", name="Undo").click()
    wait_until(page, lambda: segments(page) == ["walks 2.0 s", "bows 2.0 s", "stands still 2.0 s"])
    page.reload()
    page.wait_for_selector("html[data-shown]", state="attached")
    assert segments(page) == ["walks 2.0 s", "bows 2.0 s", "stands still 2.0 s"]


def test_enter_makes_only_the_changed_sentence_anew_and_pressed_again_another_take(
    open_page: Open, server: PlaygroundClient
) -> None:
    page = open_page(server.url, 900, 620)
    generate(page, "a person walks", seconds="2", steps="2")
    seed = seed_of(page)
    page.get_by_role("button", name="+ Sentence").click()
    wait_made(page, 2)
    page.get_by_label("What should the person do?").fill("a person bows")
    page.get_by_label("What should the person do?").press("Enter")
    wait_made(page, 3)
    assert seed_of(page) == seed
    assert page.locator(".facts").inner_text().endswith("made anew: sentence 2 of 2")
    page.get_by_label("What should the person do?").press("Enter")  # nothing has changed since
    wait_made(page, 4)
    assert seed_of(page) != seed


def test_segments_are_stretched_reordered_and_cut_with_the_mouse(open_page: Open, server: PlaygroundClient) -> None:
    page = begin(open_page, server)
    page.get_by_role("button", name="+ Sentence").click()
    wait_made(page, 2)
    assert segments(page) == ["walks 2.0 s", "stands still 2.0 s"]
    box = page.locator(".segments").bounding_box()
    assert box is not None
    second, middle, row = box["width"] / 4, box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(middle - 2, row)
    page.mouse.down()
    page.mouse.move(middle + second / 2, row, steps=4)
    page.mouse.up()
    wait_made(page, 3)
    assert segments(page)[0].startswith("walks 2.5")
    page.mouse.move(box["x"] + 40, row)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.85 * box["width"], row, steps=6)
    page.mouse.up()
    wait_made(page, 4)
    assert [text.split(" ")[0] for text in segments(page)] == ["stands", "walks"]
    ruler = page.locator(".ruler").bounding_box()
    assert ruler is not None
    page.mouse.click(ruler["x"] + 0.7 * ruler["width"], ruler["y"] + 8)
    wait_until(page, lambda: 2.8 < time_of(page) < 3.6)
    page.get_by_role("button", name="Split").click()
    wait_made(page, 5)
    assert len(segments(page)) == 3 and segments(page)[2].startswith("walks")
    page.get_by_role("button", name="Remove").click()
    wait_made(page, 6)
    assert len(segments(page)) == 2


def test_the_keyboard_does_it_all(open_page: Open, server: PlaygroundClient) -> None:
    page = begin(open_page, server)
    page.locator("canvas").press("n")
    wait_made(page, 2)
    page.locator(".segment").last.focus()
    page.keyboard.press("Shift+ArrowLeft")
    wait_made(page, 3)
    assert segments(page)[1] == "stands still 1.9 s"
    page.keyboard.press("Alt+ArrowLeft")
    wait_made(page, 4)
    assert segments(page) == ["stands still 1.9 s", "walks 2.0 s"]
    before = shows(page)
    page.keyboard.press("ArrowRight")
    assert page.locator(".segment[aria-pressed=true]").inner_text().startswith("walks")
    page.keyboard.press("Delete")
    wait_until(page, lambda: shows(page) > before and segments(page) == ["stands still 1.9 s"])
    settings(page, seconds="2.4")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: segments(page) == ["stands still 2.4 s"])
