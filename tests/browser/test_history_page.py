"""Takes and history of the playground: pick, more, keep the seed; undo and redo; reload, files, links, two tabs."""

from __future__ import annotations

import json
from pathlib import Path

from support.browsing import Open, clips_shown, download, generate, settings, shows, wait_until
from support.playground import PlaygroundClient


def seed_of(page: object) -> str:
    return page.locator(".facts").inner_text().split("seed ")[1].split(",")[0]  # type: ignore[attr-defined,no-any-return]


def test_takes_stand_beside_one_another_and_are_picked(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620)
    generate(page, "a person runs", seconds="1", seed="5", steps="2")
    page.locator(".sampling [name=seed]").fill("")
    page.locator("canvas").press("t")
    wait_until(page, lambda: page.locator(".take").count() == 4)
    assert clips_shown(page) == 1 and seed_of(page) == "5"  # they were made, and what is seen is still the first
    page.get_by_label("Take with seed 7").click()
    wait_until(page, lambda: seed_of(page) == "7")
    assert clips_shown(page) == 1  # nothing was made again
    page.locator("canvas").press("]")
    wait_until(page, lambda: seed_of(page) == "8")
    page.get_by_label("Keep seed").check()
    generate(page, "a person walks", seconds="1", steps="2")
    assert seed_of(page) == "8" and page.locator(".take").count() == 1
    page.get_by_role("button", name="Undo").click()
    wait_until(page, lambda: page.locator(".take").count() == 4)
    assert page.locator(".take[aria-pressed=true] span").inner_text() == "seed 8"


def test_steps_are_undone_and_done_again_also_after_a_reload(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620)
    field = page.get_by_label("What should the person do?")
    generate(page, "a person runs", seconds="1", seed="5", steps="2")
    page.get_by_label("In place").check()
    wait_until(page, lambda: clips_shown(page) == 2)
    generate(page, "a person bows", seconds="1", seed="6", steps="2")
    bows = download(page, ".npz", "a_person_bows_6_in_place.npz")
    page.locator("canvas").press("Control+z")
    wait_until(page, lambda: field.input_value() == "a person runs" and seed_of(page) == "5")
    assert page.get_by_label("In place").is_checked()
    page.locator("canvas").press("Control+z")
    wait_until(page, lambda: not page.get_by_label("In place").is_checked())
    page.reload()
    page.wait_for_selector("html[data-shown]", state="attached")
    assert field.input_value() == "a person runs" and not page.get_by_label("In place").is_checked()
    for _ in range(2):
        before = shows(page)
        page.locator("canvas").press("Control+Shift+z")
        wait_until(page, lambda before=before: shows(page) > before)  # type: ignore[misc]
    assert field.input_value() == "a person bows" and download(page, ".npz", "a_person_bows_6_in_place.npz") == bows
    assert page.get_by_role("button", name="Redo").is_disabled()
    page.locator("canvas").press("Control+z")
    wait_until(page, lambda: field.input_value() == "a person runs")
    field.fill("a person walks on tiptoe")
    field.press("Control+z")  # in a field, typing is undone
    wait_until(page, lambda: field.input_value() == "a person runs")


def test_a_link_is_a_step_after_the_work_that_was_kept(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620)
    field = page.get_by_label("What should the person do?")
    generate(page, "a person runs", seconds="1", seed="5", steps="2")
    for address, text in (
        ("text=a+person+walks&seconds=1&seed=3&steps=2", "a person walks"),
        ("concepts={}", "a person walks"),  # a link that says nothing of ours
    ):
        page.goto("about:blank")
        page.goto(f"{server.url}#{address}")
        page.wait_for_selector("html[data-shown]", state="attached")
        wait_until(page, lambda text=text: field.input_value() == text)  # type: ignore[misc]
    page.reload()
    page.wait_for_selector("html[data-shown]", state="attached")
    page.locator("canvas").press("Control+z")
    wait_until(page, lambda: field.input_value() == "a person runs" and seed_of(page) == "5")


def test_files_are_of_the_clip_that_is_seen(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620, refused=True)
    generate(page, "a person runs", seconds="1", seed="5", steps="2")
    runs = download(page, ".npz", "a_person_runs_5.npz")
    page.route("**/api/clip", lambda route: route.fulfill(status=400, json={"error": "no clip today"}))
    page.get_by_label("What should the person do?").fill("a person bows")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: page.locator(".error").first.is_visible())
    assert download(page, ".npz", "a_person_runs_5.npz") == runs


def test_a_project_is_a_file_and_another_browser_goes_on_with_it(
    open_page: Open, server: PlaygroundClient, tmp_path: Path
) -> None:
    page = open_page(server.url, 900, 620)
    generate(page, "a person runs", seconds="1", seed="5", steps="2")
    with page.expect_download() as waiting:
        page.locator("canvas").press("Control+s")
    file = tmp_path / waiting.value.suggested_filename
    waiting.value.save_as(file)
    assert file.name == "a_person_runs_5.kinegraph.json"
    other = open_page(server.url, 900, 620)
    wait_until(other, lambda: shows(other) == 1)
    other.locator(".open-file").set_input_files(file)
    wait_until(other, lambda: shows(other) == 2)
    assert other.get_by_label("What should the person do?").input_value() == "a person runs"
    assert download(other, ".npz") == download(page, ".npz")
    other.locator("canvas").press("Control+z")
    wait_until(other, lambda: "waves" in other.get_by_label("What should the person do?").input_value())
    alert = other.get_by_role("alert")
    for text, reason in (
        ("{", "no JSON"),
        ('{"entries": []}', "no project"),
        (json.dumps({"entries": [3]}), "no project"),
    ):
        (tmp_path / "bad.json").write_text(text)
        other.locator(".open-file").set_input_files(tmp_path / "bad.json")
        wait_until(other, lambda reason=reason: reason in alert.inner_text())  # type: ignore[misc]
    other.get_by_text("Project", exact=True).click()
    other.get_by_role("button", name="New").click()
    wait_until(other, lambda: not alert.is_visible())


def test_a_second_tab_works_meanwhile(open_page: Open, server: PlaygroundClient) -> None:
    first = open_page(server.url, 900, 620)
    generate(first, "a person runs", seconds="1", seed="5", steps="2")
    second = first.context.new_page()
    second.goto(server.url)
    second.wait_for_selector("html[data-shown]", state="attached")
    field = second.get_by_label("What should the person do?")
    assert field.input_value() == "a person runs"  # it begins where the newest left off
    generate(second, "a person bows", seconds="1", seed="6", steps="2")
    first.reload()
    first.wait_for_selector("html[data-shown]", state="attached")
    assert first.get_by_label("What should the person do?").input_value() == "a person runs"  # each has its own


def test_the_keyboard_is_told(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620)
    page.locator("canvas").press("?")
    sheet = page.get_by_role("dialog")
    assert sheet.is_visible() and "Undo" in sheet.inner_text() and "More takes" in sheet.inner_text()
    page.keyboard.press("Escape")
    assert not sheet.is_visible()
    page.locator("canvas").press("/")
    assert page.evaluate("document.activeElement.id") == "text"
    page.keyboard.type("?")
    assert not sheet.is_visible()
    page.get_by_label("What should the person do?").fill("a person runs")
    settings(page, seconds="1", steps="2")
    page.keyboard.press("Control+Enter")
    wait_until(page, lambda: clips_shown(page) == 1)


def test_a_step_that_is_asked_for_while_a_clip_is_made_is_what_is_seen(
    open_page: Open, server: PlaygroundClient
) -> None:
    page = open_page(server.url, 900, 620)
    field = page.get_by_label("What should the person do?")
    generate(page, "a person runs", seconds="1", seed="5", steps="2")
    generate(page, "a person bows", seconds="1", seed="6", steps="2")
    field.fill("a person walks forward and waves")
    settings(page, seconds="9", steps="400")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: page.locator(".cancel").is_visible())
    before = shows(page)
    page.locator("canvas").press("Control+z")  # the clip that was seen is what the step before made
    wait_until(page, lambda: field.input_value() == "a person bows" and shows(page) > before)
    page.locator("canvas").press("Control+z")
    wait_until(page, lambda: seed_of(page) == "5")
    assert field.input_value() == "a person runs" and page.locator(".status").inner_text().strip() == ""
    assert page.locator("canvas").get_attribute("aria-label") == "a person runs"
    assert clips_shown(page) == 2 and not page.locator(".cancel").is_visible()


def test_a_link_that_is_opened_in_the_same_tab_waits_to_be_made(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620)
    generate(page, "a person runs", seconds="1", seed="5", steps="2")
    page.evaluate("location.hash = 'text=a+person+bows&seconds=1&seed=6&steps=2'")
    field = page.get_by_label("What should the person do?")
    wait_until(page, lambda: field.input_value() == "a person bows")
    assert "Press Generate" in page.locator(".status").inner_text() and clips_shown(page) == 1
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: clips_shown(page) == 2 and seed_of(page) == "6")


def test_a_take_is_one_of_what_is_seen_whatever_stands_in_the_form(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620)
    field = page.get_by_label("What should the person do?")
    generate(page, "a person runs", seconds="1", seed="5", steps="2")
    page.locator("canvas").press("t")
    wait_until(page, lambda: page.locator(".take").count() == 4)
    field.fill("a person bows")
    page.get_by_label("Take with seed 7").click()
    wait_until(page, lambda: seed_of(page) == "7")
    assert field.input_value() == "a person runs" and clips_shown(page) == 1
    page.get_by_role("button", name="Undo").click()
    wait_until(page, lambda: field.input_value() == "a person bows")  # what was typed is not lost


def test_takes_that_are_asked_for_can_be_cancelled(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620)
    generate(page, "a person walks forward", seconds="9", seed="5", steps="200")
    page.locator("canvas").press("t")
    wait_until(page, lambda: "Take 1" in page.locator(".status").inner_text())
    assert page.locator(".cancel").is_visible()
    page.locator("canvas").press("Escape")
    wait_until(page, lambda: not page.locator(".cancel").is_visible())
    assert page.locator(".status").inner_text().strip() == "" and not page.locator(".error").is_visible()
