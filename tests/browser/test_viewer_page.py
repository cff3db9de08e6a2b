"""The page of clips in a browser: drawing, playback, keyboard and mouse, on wide and narrow screens."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from kinegraph.clip import Clip
from kinegraph.formats.html import clips_page as page_of
from support.browsing import Open, changed, picture_at, time_of, wait_until
from support.cli_runs import whole
from support.motions import walk

if TYPE_CHECKING:
    from playwright.sync_api import Page

HOSTILE = "</script><img src=x onerror=alert(1)> \u2028 走る"


def clip(text: str = "a person walks", frames: int = 60) -> Clip:
    return Clip(walk(frames), 20.0, 7, text, "edge 1.2", whole(text))


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("page") / "one.html"
    file.write_bytes(page_of([clip()]))
    return file.as_uri()


def stands_still(page: Page) -> bool:
    """Tell whether no other frame is drawn for a second; on a busy machine one may come late."""
    before = time_of(page)
    page.wait_for_timeout(1000)
    return time_of(page) == before


def test_the_body_is_drawn_and_moves_with_time(open_page: Open, one: str) -> None:
    page = open_page(one)
    early, late, again = picture_at(page, 0.5), picture_at(page, 1.2), picture_at(page, 0.5)
    assert changed(early, again) == 0
    assert changed(early, late) > 0.01


def test_it_plays_pauses_and_slows_down(open_page: Open, tmp_path: Path) -> None:
    (tmp_path / "long.html").write_bytes(page_of([clip(frames=600)]))
    page = open_page((tmp_path / "long.html").as_uri())
    page.wait_for_timeout(200)
    assert time_of(page) == 0
    page.get_by_role("button", name="Play").click()
    wait_until(page, lambda: time_of(page) > 0.3)
    page.get_by_role("button", name="Pause").click()
    wait_until(page, lambda: stands_still(page))
    stopped = time_of(page)
    page.wait_for_timeout(300)
    assert time_of(page) == stopped
    assert stopped < 25  # of 30 s: it was paused, and did not end
    page.get_by_label("Speed").select_option("0.25")
    page.get_by_role("button", name="Play").click()
    wait_until(page, lambda: time_of(page) > stopped)
    began, clock = time_of(page), time.monotonic()
    wait_until(page, lambda: time_of(page) > began + 0.3)
    assert (time_of(page) - began) / (time.monotonic() - clock) < 0.6


RESTS = """() => new Promise((resolve) => {
  const canvas = document.querySelector("canvas");
  const began = performance.now();
  let [at, since, longest, rounds] = [-1, began, 0, 0];
  const look = (now) => {
    const time = Number(canvas.dataset.time);
    if (time !== at) {
      if (time < at) rounds += 1;
      [at, since] = [time, now];
    } else longest = Math.max(longest, now - since);
    if (now - began < 8000 && rounds < 3) requestAnimationFrame(look);
    else resolve([longest, rounds]);
  };
  requestAnimationFrame(look);
})"""
"""Longest time that nothing moves, milliseconds, and how often the clip began again; three times, or for 8 s."""


@pytest.mark.parametrize("loops", [True, False])
def test_a_loop_goes_round_without_a_rest(open_page: Open, tmp_path: Path, loops: bool) -> None:
    (tmp_path / "loop.html").write_bytes(page_of([replace(clip(frames=21), loops=loops)]))
    page = open_page((tmp_path / "loop.html").as_uri())
    page.get_by_role("button", name="Play").click()
    longest, rounds = page.evaluate(RESTS)
    assert rounds >= 2
    assert longest < 300 if loops else longest > 400


def test_it_plays_by_itself_unless_less_motion_is_wished(open_page: Open, one: str) -> None:
    page = open_page(one, reduced_motion="no-preference")
    wait_until(page, lambda: time_of(page) > 0.1)


def test_the_keyboard_does_it_all(open_page: Open, one: str) -> None:
    page = open_page(one)
    picture_at(page, 1.0)
    page.locator("body").press(".")
    page.wait_for_timeout(200)
    assert time_of(page) == pytest.approx(1.05)
    page.locator("body").press(",")
    page.wait_for_timeout(200)
    assert time_of(page) == pytest.approx(1.0)
    page.locator("body").press(" ")
    assert page.get_by_role("button", name="Pause").is_visible()
    page.locator("body").press(" ")
    before = picture_at(page, 1.0)
    for key in ("ArrowLeft", "ArrowUp", "+"):
        page.locator("canvas").press(key)
    page.wait_for_timeout(300)
    turned = picture_at(page, 1.0)
    assert changed(before, turned) > 0.02
    page.locator("body").press("0")
    page.wait_for_timeout(300)
    assert changed(before, picture_at(page, 1.0)) == 0


def test_dragging_turns_the_camera(open_page: Open, one: str) -> None:
    page = open_page(one)
    before = picture_at(page, 1.0)
    page.mouse.move(150, 150)
    page.mouse.down()
    page.mouse.move(260, 170, steps=4)
    page.mouse.up()
    page.wait_for_timeout(400)
    assert changed(before, picture_at(page, 1.0)) > 0.02


def test_caption_and_graph_stand_beside_it_whatever_they_say(open_page: Open, tmp_path: Path) -> None:
    (tmp_path / "page.html").write_bytes(page_of([clip(HOSTILE), clip("another")]))
    page = open_page((tmp_path / "page.html").as_uri(), 1000, 600)
    page.wait_for_selector("canvas[data-panes='2']")
    assert page.locator(".clip h2").all_text_contents() == [HOSTILE, "another"]
    assert page.locator(".panes p").all_text_contents() == [HOSTILE, "another"]
    assert page.locator(".clip .node .words").all_text_contents() == [HOSTILE, "another"]
    assert page.locator("img").count() == 0


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1280, 800)])
def test_nothing_is_cut_off(open_page: Open, one: str, width: int, height: int) -> None:
    page = open_page(one, width, height)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    box = page.locator("canvas").bounding_box()
    assert box is not None and box["height"] > 0.4 * height


def test_it_is_dark_where_that_is_wished(open_page: Open, one: str) -> None:
    light, dark = (picture_at(open_page(one, color_scheme=scheme), 1.0) for scheme in ("light", "dark"))
    assert changed(light, dark) > 0.8
