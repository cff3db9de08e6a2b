"""The first look at the playground: somebody moves already; examples, search, and unknown words with what is near."""

from __future__ import annotations

import re

from support.browsing import Open, changed, clips_shown, picture_at, shows, time_of, wait_until
from support.playground import PlaygroundClient


def test_a_person_moves_before_anything_is_asked(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, reduced_motion="no-preference")
    wait_until(page, lambda: shows(page) == 1)
    wait_until(page, lambda: time_of(page) > 0.1)
    page.get_by_role("button", name="Pause").click()
    assert changed(picture_at(page, 0.5), picture_at(page, 2.0)) > 0.01
    assert clips_shown(page) == 0  # nothing was made for it
    assert "seed 7" in page.locator(".facts").inner_text() and page.locator(".graph .words").count() > 2
    assert page.locator("canvas").get_attribute("data-panes") == "1"


def test_examples_are_made_at_once(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 1000, 700)
    field = page.get_by_label("What should the person do?")
    assert 6 <= page.locator(".chip.action").count() <= 12
    page.locator(".chip.action", has_text=re.compile("^runs$")).click()
    wait_until(page, lambda: clips_shown(page) == 1)
    assert field.input_value() == "a person runs"
    page.locator(".chip.style", has_text="like an old person").click()
    wait_until(page, lambda: clips_shown(page) == 2)
    page.locator(".chip.style", has_text="energetically").click()  # one style goes in place of another
    wait_until(page, lambda: clips_shown(page) == 3)
    assert field.input_value() == "a person runs energetically"
    page.get_by_label("Search known actions").fill("wav lef")
    (hit,) = page.locator(".found .chip").all()
    assert re.fullmatch(r"waves the left arm\d+ %", hit.text_content() or "")
    assert re.fullmatch(r"waves the left arm, recognised in \d+ % of its clips", hit.get_attribute("aria-label") or "")
    page.keyboard.press("Enter")
    wait_until(page, lambda: clips_shown(page) == 4)
    assert field.input_value() == "a person waves the left arm"
    page.get_by_label("Search known actions").fill("juggles")
    assert "Nothing like that" in page.locator(".found").inner_text()


def test_unknown_words_are_yellow_where_they_stand_and_give_way_to_what_is_near(
    open_page: Open, server: PlaygroundClient
) -> None:
    page = open_page(server.url)
    field = page.get_by_label("What should the person do?")
    field.fill("a person walks and juggles")
    wait_until(page, lambda: page.locator(".behind mark").all_text_contents() == ["juggles"])
    near = page.locator("#told .near").first
    known = near.inner_text().strip("\u201c\u201d")
    near.click()
    assert field.input_value() == f"a person walks and {known}"
    wait_until(page, lambda: not page.locator("#told").is_visible())
    assert page.locator(".behind mark").count() == 0
    assert page.evaluate("document.activeElement.id") == "text"
