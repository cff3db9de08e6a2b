"""Authoring in the playground: a path drawn on the floor, waypoints and pins, on a timeline; all of it undone."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlencode

import pytest

from kinegraph import MotionPipeline
from kinegraph.formats import encode
from kinegraph.formats.constraints_json import decode
from support.browsing import Open, clips_shown, download, generate, picture_at, shows, wait_until
from support.characters import BUILDS, make_character
from support.playground import PlaygroundClient

if TYPE_CHECKING:
    from playwright.sync_api import Page


TEXTS = ["a person walks forward", "a person waves the right hand", "a person walks forward"]
SCENE = "#" + urlencode({"texts": json.dumps(TEXTS), "seconds": "1,1,1", "seed": 3, "steps": 2})
"""Three sentences of a second each, as a link; `test_timeline_page` authors such by hand."""


FLOOR = 0.68
"""Share of half the height of the stage by which the floor under a person is below the middle."""

pytestmark = pytest.mark.timeout(900)


@pytest.fixture(autouse=True)
def constrained(pipe: MotionPipeline) -> None:
    assert pipe.sampler.sessions.decoder_gradients


def wait_made(page: Page, count: int) -> None:
    wait_until(page, lambda: clips_shown(page) >= count, 60)


def pins(page: Page) -> list[str]:
    """What each pin says: its name, its time, and the miss of the clip that is seen."""
    found: list[str] = page.locator(".tracks .pin").evaluate_all("pins => pins.map((pin) => pin.ariaLabel)")
    return found


def misses(page: Page) -> list[float]:
    """Centimetres."""
    return [float(found[1]) for found in (re.search(r"missed by ([\d.]+) cm", text) for text in pins(page)) if found]


def draw_path(page: Page) -> None:
    """Draw a way on the floor with the mouse."""
    page.get_by_role("button", name="Path").click()
    box = page.locator("canvas").bounding_box()
    assert box is not None
    x, y = box["x"], box["y"]
    page.mouse.move(x + 0.5 * box["width"], y + 0.8 * box["height"])
    page.mouse.down()
    for share in (0.55, 0.6, 0.66, 0.72):
        page.mouse.move(x + share * box["width"], y + 0.85 * box["height"], steps=3)
    page.mouse.up()


def pin(page: Page, name: str) -> None:
    page.get_by_text("Pin", exact=True).click()
    page.get_by_role("button", name=name, exact=True).click()


def test_a_scene_is_authored_exported_undone_and_found_again(
    open_page: Open, server: PlaygroundClient, pipe: MotionPipeline, tmp_path: Path
) -> None:
    page = open_page(server.url + SCENE, 900, 620)
    wait_made(page, 1)
    assert page.locator(".segment").count() == 3
    picture_at(page, 1.5)
    draw_path(page)
    wait_made(page, 2)
    assert len(pins(page)) == 1 and pins(page)[0].startswith("path from 0.0 to 3.0 s") and misses(page)[0] < 10
    pin(page, "right hand")
    wait_made(page, 3)
    assert pins(page)[1].startswith("right hand at 1.5 s") and max(misses(page)) < 10
    # takes, an own character, a file with it
    page.get_by_role("button", name="More takes").click()
    wait_until(page, lambda: page.locator(".take").count() == 4, 120)
    page.get_by_label("Take with seed 5").click()
    wait_until(page, lambda: "seed 5" in page.locator(".facts").inner_text())
    hero = tmp_path / "hero.glb"
    hero.write_bytes(make_character(BUILDS["Mixamo, T-pose, centimetres"]))
    before = shows(page)
    page.locator(".character-file").set_input_files(hero)
    wait_until(page, lambda: shows(page) > before)
    data = fetch(page)
    assert b"mixamorig" in data
    # undo through all of it, and all of it again after a reload
    press_all(page, "Undo")
    wait_until(page, lambda: pins(page) == [], 60)
    page.reload()
    page.wait_for_selector("html[data-shown]", state="attached")
    press_all(page, "Redo")
    wait_until(page, lambda: page.locator(".segment").count() == 3 and len(pins(page)) == 2, 60)
    wait_until(page, lambda: "seed 5" in page.locator(".facts").inner_text(), 60)
    assert fetch(page) == data


def press_all(page: Page, name: str) -> None:
    """Undo or redo as far as it goes, without waiting for what is seen between."""
    button = page.get_by_role("button", name=name)
    for _ in range(20):
        if button.is_disabled():
            return
        button.click()
    raise AssertionError(f"{name} has no end")


def fetch(page: Page) -> bytes:
    """Download the GLB, whatever it is called."""
    with page.expect_download(timeout=60_000) as waiting:
        page.locator("[data-suffix='.glb']").click()
    return Path(waiting.value.path()).read_bytes()


def test_one_sentence_with_pins_is_the_clip_of_the_pipeline(
    open_page: Open, server: PlaygroundClient, pipe: MotionPipeline
) -> None:
    page = open_page(server.url, 900, 620)
    generate(page, "a person walks forward", seconds="3", seed="3", steps="3")
    picture_at(page, 2.0)
    page.get_by_role("button", name="Waypoint").click()
    wait_made(page, 2)
    for axis, value in (("x", "0.5"), ("z", "1.6")):
        page.get_by_label(f"{axis} of the waypoint").fill(value)
        page.get_by_label(f"{axis} of the waypoint").press("Enter")
    wait_until(page, lambda: clips_shown(page) >= 3 and not page.get_by_role("button", name="Cancel").is_visible())
    wanted = decode([{"type": "waypoint", "seconds": 2, "position": [0.5, 1.6]}])
    clip = pipe.generate("a person walks forward", seconds=3, seed=3, steps=3, constraints=wanted)
    assert download(page, ".npz") == encode(clip, ".npz")
    # by the keyboard: it moves, in time, too, and goes
    count = clips_shown(page)
    page.locator(".pin").focus()
    page.keyboard.press("ArrowUp")
    wait_made(page, count + 1)
    page.keyboard.press("Shift+ArrowRight")
    wait_made(page, count + 2)
    assert pins(page)[0].startswith("waypoint at 2.1 s")
    assert page.get_by_label("z of the waypoint").input_value() == "1.7"
    page.keyboard.press("Delete")
    wait_made(page, count + 3)
    assert pins(page) == [] and page.evaluate("document.activeElement.innerText") == "Path"


def drafts(page: Page) -> int:
    """Count the drafts that were seen."""
    return int(page.locator("html").get_attribute("data-drafts") or 0)


def balls(page: Page) -> tuple[float, float]:
    """Where on the screen the person's root is above the floor: in the middle, as the camera looks there."""
    box = page.locator("canvas").bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.5 * (1 + FLOOR)


def test_a_waypoint_that_is_dragged_is_seen_as_a_draft_and_then_made(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620)
    generate(page, "a person walks forward", seconds="2", seed="3", steps="2")
    picture_at(page, 1.0)
    page.get_by_role("button", name="Waypoint").click()
    wait_made(page, 2)
    assert "draft seen after" in page.locator(".stages").text_content()
    before = page.get_by_label("z of the waypoint").input_value()
    x, y = balls(page)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y, steps=3)
    wait_until(page, lambda: drafts(page) > 1)
    wait_made(page, 3)  # where it rests, the clip is made, and it is no step
    seen = drafts(page)
    page.mouse.move(x + 40, y, steps=3)
    wait_until(page, lambda: drafts(page) > seen)
    page.mouse.up()
    wait_made(page, 4)
    assert page.get_by_label("z of the waypoint").input_value() != before
    assert misses(page)[0] < 10 and page.locator(".panes p").inner_text() == ""  # no draft any more
    page.get_by_role("button", name="Undo").click()
    wait_until(page, lambda: page.get_by_label("z of the waypoint").input_value() == before)


def test_a_pin_with_a_free_axis_stands_where_its_joint_is(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620)
    generate(page, "a person walks forward", seconds="2", seed="3", steps="2")
    picture_at(page, 1.9)
    pin(page, "head")
    wait_made(page, 2)
    for axis, count in (("x", 3), ("z", 4)):
        page.get_by_label(f"{axis} of the head").fill("")
        page.get_by_label(f"{axis} of the head").press("Enter")
        wait_made(page, count)
    assert page.get_by_label("z of the head").get_attribute("placeholder") == "free"
    # the camera looks at the root, and the ball is above it, not at the origin, which is a metre behind
    picture_at(page, 1.9)
    box = page.locator("canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    places = [(x + 12 * across, y - 6 * up) for up in range(4, 24) for across in (-2, -1, 0, 1, 2)]
    assert any(is_grasped(page, *place) for place in places)


def is_grasped(page: Page, x: float, y: float) -> bool:
    """Tell whether a press there would take hold of something."""
    page.mouse.move(x, y)
    return page.locator(".view.grab").count() > 0


def test_nothing_is_placed_by_a_clip_that_goes_nowhere(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url)
    generate(page, "a person walks forward", seconds="2", seed="3", steps="2")
    page.get_by_label("In place").check()
    wait_made(page, 2)
    page.get_by_role("button", name="Waypoint").click()
    wait_until(page, lambda: "In place off" in page.locator(".status").inner_text())
    assert pins(page) == []
    page.get_by_label("In place").uncheck()
    wait_made(page, 3)
    page.get_by_role("button", name="Waypoint").click()
    wait_until(page, lambda: len(pins(page)) == 1)
