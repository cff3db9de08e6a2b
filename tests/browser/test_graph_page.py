"""The graph editor of the playground: sliders change the motion; words are hidden, deleted, added and replaced."""

from __future__ import annotations

from pathlib import Path

from kinegraph import cli
from support.browsing import Open, changed, clips_shown, download, generate, picture_at, wait_until
from support.playground import PlaygroundClient


def test_a_slider_changes_the_motion_and_keeps_the_seed(
    open_page: Open, server: PlaygroundClient, tmp_path: Path
) -> None:
    page = open_page(server.url)
    generate(page, "a person walks and turns to the left", seconds="3", steps="6")  # the seed is drawn
    before, facts = picture_at(page, 2.5), page.locator(".facts").inner_text()
    page.get_by_label("Weight of to the left").fill("0")
    wait_until(page, lambda: clips_shown(page) == 2)
    assert page.locator(".facts").inner_text() == facts
    assert changed(before, picture_at(page, 2.5)) > 0.01
    seed = facts.split("seed ")[1].split(",")[0]
    flags = ["--weight", "to the left=0", "--seconds", "3", "--steps", "6", "--seed", seed, "--threads", "1", "--quiet"]
    assert cli.main(["generate", "a person walks and turns to the left", *flags, "-o", str(tmp_path / "x.npz")]) == 0
    assert download(page, ".npz") == (tmp_path / "x.npz").read_bytes()
    page.get_by_role("button", name="As parsed").click()
    wait_until(page, lambda: clips_shown(page) == 3)
    assert changed(before, picture_at(page, 2.5)) == 0


def test_the_graph_is_edited(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url)
    generate(page, "a person walks slowly", seconds="1", seed="1", steps="2")
    page.get_by_label("Delete slowly").click()
    wait_until(page, lambda: clips_shown(page) == 2)
    page.get_by_label("Hide the words walks").click()
    wait_until(page, lambda: clips_shown(page) == 3)
    page.get_by_text("Add a detail").click()
    page.get_by_label("Kind of detail").select_option("ARGM-DIR")
    page.get_by_label("Words", exact=True).first.fill("to the right")
    page.get_by_role("button", name="Add", exact=True).first.click()
    wait_until(page, lambda: clips_shown(page) == 4)
    page.get_by_text("Add an action").click()
    page.get_by_label("Words", exact=True).last.fill("waves")
    page.get_by_label("Words", exact=True).last.press("Enter")
    wait_until(page, lambda: clips_shown(page) == 5)
    assert page.locator(".graph .caption").inner_text() == "a person hidden to the right and waves"
    assert page.get_by_label("Delete waves").count() == 1


def test_words_of_a_node_are_replaced_by_the_keyboard_alone(
    open_page: Open, server: PlaygroundClient, tmp_path: Path
) -> None:
    page = open_page(server.url)
    generate(page, "a person walks slowly", seconds="1.5", seed="1", steps="3")
    page.get_by_label("Other words for slowly").focus()
    page.keyboard.press("Enter")
    page.keyboard.type("quick")
    page.keyboard.press("Escape")
    assert page.get_by_label("Other words for slowly").inner_text() == "slowly" and clips_shown(page) == 1
    page.keyboard.press("Enter")
    page.keyboard.type("quickly")
    page.keyboard.press("Enter")
    wait_until(page, lambda: clips_shown(page) == 2)
    assert page.evaluate("document.activeElement.ariaLabel") == "Other words for quickly"
    assert page.locator(".graph .caption").inner_text() == "a person walks quickly"
    flags = ["--replace", "slowly=quickly", "--seconds", "1.5", "--seed", "1", "--steps", "3", "--threads", "1"]
    assert cli.main(["generate", "a person walks slowly", *flags, "--quiet", "-o", str(tmp_path / "x.npz")]) == 0
    assert download(page, ".npz") == (tmp_path / "x.npz").read_bytes()


def test_the_keyboard_stays_at_what_was_edited(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url)
    generate(page, "a person walks slowly to the left", seconds="1", seed="1", steps="2")
    for name, focused in (
        ("Hide the words slowly", "Other words for [MASK]"),
        ("Delete [MASK]", "Other words for to the left"),
    ):
        count = clips_shown(page)
        page.get_by_label(name, exact=True).focus()
        page.keyboard.press("Enter")
        wait_until(page, lambda count=count: clips_shown(page) > count)  # type: ignore[misc]
        assert page.evaluate("document.activeElement.ariaLabel") == focused
    page.get_by_text("Add a detail").click()
    page.get_by_label("Words", exact=True).first.fill("fast")
    page.keyboard.press("Enter")
    wait_until(page, lambda: clips_shown(page) == 4)
    assert page.evaluate("document.activeElement.innerText") == "Add a detail"
