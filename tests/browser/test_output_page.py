"""Output of the playground: shape, rate, root joint, names; the program to copy; the own character."""

from __future__ import annotations

import io
import shlex
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from kinegraph import MotionPipeline, cli
from support.browsing import Open, clips_shown, download, generate, shows, wait_until
from support.characters import BUILDS, make_character
from support.playground import PlaygroundClient


def test_what_is_asked_of_files_is_in_them_and_in_their_names(
    open_page: Open, server: PlaygroundClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pipe: MotionPipeline
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(MotionPipeline, "load", lambda *_, **__: pipe)
    page = open_page(server.url, 900, 620)
    generate(page, "a person runs", seconds="2", seed="3", steps="3")
    page.get_by_label("Loop").check()
    wait_until(page, lambda: clips_shown(page) == 2)
    page.get_by_label("In place").check()
    wait_until(page, lambda: clips_shown(page) == 3)
    page.get_by_label("Frames a second").select_option("60")
    page.get_by_label("Root joint").check()
    page.get_by_label("Joint names").select_option("mixamo")
    data = download(page, ".glb", "a_person_runs_3_loop_in_place_60fps.glb")
    page.get_by_text("As a program").click()
    program = page.get_by_label("Program", exact=True)
    exec(compile(program.inner_text(), "program", "exec"), {})  # noqa: S102
    assert (tmp_path / "a_person_runs_3_loop_in_place_60fps.glb").read_bytes() == data
    page.get_by_role("button", name="Command line").click()
    words = shlex.split(program.inner_text())
    with redirect_stdout(io.StringIO()):
        assert words[0] == "kinegraph" and cli.main([*words[1:], "--force", "--quiet"]) == 0
    assert (tmp_path / "a_person_runs_3_loop_in_place_60fps.glb").read_bytes() == data
    # a plain format has no joints to name, and every one that is offered comes
    names = [name.lower() for name in page.locator(".downloads button").all_text_contents()]
    assert {"glb", "bvh", "npz", "json", "vrma", "html"} <= set(names)
    for name in set(names) - {"glb", "mp4"}:
        assert len(download(page, f".{name}", f"a_person_runs_3_loop_in_place_60fps.{name}")) > 1000, name


def test_the_program_can_be_copied(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 900, 620, permissions=["clipboard-read", "clipboard-write"])
    page.get_by_text("As a program").click()
    copy = page.locator(".copy")
    copy.click()
    copy.click()  # twice in quick succession: it says "Copied" no longer for that
    wait_until(page, lambda: copy.inner_text() == "Copied")
    assert page.evaluate("navigator.clipboard.readText()") == page.locator(".code pre").text_content()
    wait_until(page, lambda: copy.inner_text() == "Copy")


def test_an_own_character_is_seen_and_exported(
    open_page: Open, server: PlaygroundClient, pipe: MotionPipeline, tmp_path: Path
) -> None:
    hero = tmp_path / "my hero.glb"
    hero.write_bytes(make_character(BUILDS["Mixamo, T-pose, centimetres"]))
    page = open_page(server.url, 900, 620)
    generate(page, "a person runs", seconds="2", seed="3", steps="3")
    before = shows(page)
    page.locator(".character-file").set_input_files(hero)
    wait_until(page, lambda: shows(page) > before)
    assert page.locator(".choose").inner_text() == "my hero.glb"
    data = download(page, ".glb", "a_person_runs_3_my_hero.glb")
    clip = pipe.generate("a person runs", seconds=2, seed=3, steps=3)
    assert data == clip.onto(hero).encode()
    generate(page, "a person walks", seconds="1", seed="1", steps="2")  # the next clip is seen on it, too
    page.reload()
    page.wait_for_selector("html[data-shown]", state="attached")
    assert page.locator(".choose").inner_text() == "my hero.glb"
    page.get_by_label("Without my hero.glb").click()
    wait_until(page, lambda: shows(page) == 2)
    assert page.locator(".choose").inner_text() == "Own…"


def test_what_is_no_character_is_told_and_changes_nothing(
    open_page: Open, server: PlaygroundClient, tmp_path: Path
) -> None:
    page = open_page(server.url, 900, 620, refused=True)
    alert = page.get_by_role("alert")
    for name, data, reason in (
        ("hero.fbx", b"x", "no .glb or .vrm"),
        ("hero.glb", b"no glTF at all", "cannot be used as a character"),
    ):
        (tmp_path / name).write_bytes(data)
        page.locator(".character-file").set_input_files(tmp_path / name)
        wait_until(page, lambda reason=reason: reason in alert.inner_text())  # type: ignore[misc]
        assert page.locator(".choose").inner_text() == "Own…"
    generate(page, "a person runs", seconds="1", seed="3", steps="2")
