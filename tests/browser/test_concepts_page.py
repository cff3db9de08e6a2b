"""Concepts in the playground: weights, method and shares give the clip of `kinegraph compose`."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinegraph import cli
from support.browsing import Open, clips_shown, download, settings, wait_until
from support.playground import PlaygroundClient


def test_concepts_are_composed(open_page: Open, server: PlaygroundClient, tmp_path: Path) -> None:
    page = open_page(server.url)
    page.get_by_label("Concepts").check()
    page.get_by_role("button", name="Add a concept").click()
    page.get_by_label("Concept", exact=True).last.fill("a person runs")
    page.locator(".concepts").get_by_label("Weight").last.fill("-0.5")
    assert page.locator(".rows output").last.inner_text() == "not ×0.5"
    page.get_by_label("Method").select_option("latent")
    settings(page, seconds="2", seed="3", steps="3")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: clips_shown(page) >= 1 and "seed 3," in page.locator("body").inner_text())
    words = ["--and", "a person walks forward", "--and", "a person waves the right hand", "--not", "a person runs:0.5"]
    flags = ["--method", "latent", "--seconds", "2", "--seed", "3", "--steps", "3", "--threads", "1", "--quiet"]
    assert cli.main(["compose", *words, *flags, "-o", str(tmp_path / "x.npz")]) == 0
    assert download(page, ".npz") == (tmp_path / "x.npz").read_bytes()


def test_how_concepts_are_mixed_goes_to_the_clip_the_link_and_the_file(
    open_page: Open, server: PlaygroundClient, tmp_path: Path
) -> None:
    page = open_page(server.url)
    page.get_by_label("Concepts").check()
    assert not page.get_by_label("Share of latent").is_visible()  # hidden until asked for
    page.get_by_text("How they are mixed").click()
    page.get_by_label("Joint sentence", exact=True).fill("a person walks while waving")
    page.get_by_label("Share of semantic").fill("0.7")
    page.get_by_label("Share of latent").fill("0.1")
    assert page.locator(".shares output").all_text_contents() == ["10 %", "75 %", "15 %"]
    page.get_by_label("Adapt the words").check()
    page.get_by_label("Attention step").fill("0.1")
    settings(page, seconds="1.5", seed="3", steps="3")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: clips_shown(page) >= 1 and "seed 3," in page.locator("body").inner_text())
    words = ["--and", "a person walks forward", "--and", "a person waves the right hand"]
    mixed = ["--text", "a person walks while waving", "--lambdas", "0.1,0.75,0.15", "--agd", "0.1,0.2"]
    flags = ["--seconds", "1.5", "--seed", "3", "--steps", "3", "--threads", "1", "--quiet"]
    assert cli.main(["compose", *words, *mixed, *flags, "-o", str(tmp_path / "x.npz")]) == 0
    assert download(page, ".npz") == (tmp_path / "x.npz").read_bytes()
    page.get_by_role("button", name="Link").click()
    wait_until(page, lambda: "#" in page.url)
    other = open_page(page.url)
    wait_until(other, lambda: clips_shown(other) == 1)
    assert other.get_by_label("Share of semantic").is_visible()
    assert other.locator(".shares output").all_text_contents() == ["10 %", "75 %", "15 %"]
    assert download(other, ".npz") == (tmp_path / "x.npz").read_bytes()


@pytest.mark.parametrize("name", ["latent", "semantic", "joint sentence"])
def test_shares_always_sum_to_one(open_page: Open, server: PlaygroundClient, name: str) -> None:
    page = open_page(server.url)
    page.get_by_label("Concepts").check()
    page.get_by_text("How they are mixed").click()
    page.get_by_label(f"Share of {name}").focus()
    seen = set()
    for key in ("Home", *["ArrowRight"] * 20, *["ArrowLeft"] * 7):
        page.keyboard.press(key)
        shares = [int(text.removesuffix(" %")) for text in page.locator(".shares output").all_text_contents()]
        assert sum(shares) == 100 and min(shares) >= 0
        seen.add(shares[["latent", "semantic", "joint sentence"].index(name)])
    assert seen == set(range(0, 101, 5))


def test_what_does_not_mix_is_hidden_or_said(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url)
    page.get_by_label("Concepts").check()
    page.get_by_text("How they are mixed").click()
    page.get_by_label("Share of latent").fill("0.5")
    page.get_by_label("Adapt the words").check()
    page.get_by_label("Regularisation step").fill("7")
    settings(page, seconds="1", seed="1", steps="2")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: "agd must be two step sizes from 0 to 1" in page.get_by_role("alert").inner_text())
    page.get_by_label("Adapt the words").uncheck()
    assert not page.get_by_label("Regularisation step").is_visible()
    page.get_by_label("Method").select_option("semantic")
    assert not page.get_by_label("Share of latent").is_visible()
    page.get_by_role("button", name="Generate").click()  # shares of "fused" are not sent with another method
    wait_until(page, lambda: clips_shown(page) >= 1 and "seed 1," in page.locator("body").inner_text())
    page.get_by_label("Method").select_option("parts")
    settings(page, seed="2")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: "seed 2," in page.locator("body").inner_text())
    page.locator(".concepts").get_by_label("Weight").first.fill("0.5")
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: "has the weight 0.5" in page.get_by_role("alert").inner_text())
    for slider in page.locator(".concepts").get_by_label("Weight").all():
        slider.fill("0")
    wait_until(page, lambda: "1 to 8 concepts, not 0" in page.get_by_role("alert").inner_text())
    assert page.locator(".rows output").all_text_contents() == ["left out", "left out"]
