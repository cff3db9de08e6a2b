"""Accessibility of the playground: labels, contrast, width, and keyboard order."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from support.browsing import Open, clips_shown, generate, wait_until
from support.playground import PlaygroundClient

if TYPE_CHECKING:
    from playwright.sync_api import Page

LABELS = """() => [...document.querySelectorAll("button, input, select, textarea, summary, canvas")]
  .filter((one) => one.checkVisibility())
  .filter((one) => !(one.ariaLabel || one.innerText?.trim() || one.labels?.length))
  .map((one) => one.outerHTML)"""

# elements that end to the right of their column
BEYOND = """() => [...document.querySelectorAll(".wish *")]
  .filter((one) => one.checkVisibility() && !one.closest(".out, .modes"))
  .filter((one) => one.getBoundingClientRect().right > one.closest(".wish").getBoundingClientRect().right + 0.5)
  .map((one) => one.outerHTML)"""

# WCAG 2.2: contrast ratio, from relative luminance, of every element with text of its own
CONTRASTS = """() => {
  const channels = (text) => (text.match(/[\\d.]+/g) ?? []).map(Number);
  const lightness = ([r, g, b]) => {
    const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
    const [x, y, z] = [r, g, b].map((c) => linear(c / 255));
    return 0.2126 * x + 0.7152 * y + 0.0722 * z;
  };
  const ground = (one) => {
    for (; one; one = one.parentElement) {
      const colour = channels(getComputedStyle(one).backgroundColor);
      if (colour.length === 3 || colour[3] > 0) return colour;
    }
    return [255, 255, 255];
  };
  return [...document.querySelectorAll("body *")]
    .filter((one) => one.checkVisibility() && [...one.childNodes].some((n) => n.nodeType === 3 && n.data.trim()))
    .filter((one) => !["SCRIPT", "STYLE", "OPTION", "NOSCRIPT"].includes(one.tagName))
    .filter((one) => getComputedStyle(one).color !== "rgba(0, 0, 0, 0)")
    .map((one) => {
      const [a, b] = [channels(getComputedStyle(one).color), ground(one)].map(lightness).sort((p, q) => q - p);
      return [one.className || one.tagName, one.innerText, (a + 0.05) / (b + 0.05)];
    });
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844), (320, 700)])
def test_labels_contrast_and_width(
    open_page: Open, server: PlaygroundClient, scheme: str, width: int, height: int
) -> None:
    page = open_page(server.url, width, height, color_scheme=scheme)
    generate(page, seconds="1", seed="1", steps="2")
    look_at_labels_and_contrasts(page, width)
    page.get_by_label("Concepts").check()
    page.get_by_text("How they are mixed").click()
    page.get_by_label("Adapt the words").check()
    wait_until(page, lambda: clips_shown(page) == 2)
    look_at_labels_and_contrasts(page, width)


def look_at_labels_and_contrasts(page: Page, width: int) -> None:
    assert page.evaluate(LABELS) == []
    contrasts = page.evaluate(CONTRASTS)
    assert len(contrasts) > 20
    assert [contrast for contrast in contrasts if contrast[2] < 4.5] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate(BEYOND) == []


def test_focus_goes_from_the_sentence_to_the_button_and_on(open_page: Open, server: PlaygroundClient) -> None:
    page = open_page(server.url, 1280, 800)
    seen = []
    for _ in range(4):
        seen.append(page.evaluate("document.activeElement.id || document.activeElement.innerText"))
        page.keyboard.press("Tab")
    assert seen[:3] == ["text", "Length, seed, steps", "Generate"]
    page.get_by_label("What should the person do?").focus()
    page.keyboard.press("Enter")
    wait_until(page, lambda: clips_shown(page) == 1)
