"""The model card: all that the bundle says of itself, as Markdown; that of the default bundle in docs is up to date."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("kinegraph_export")

from kinegraph.bundle.reader import DEFAULT_BUNDLE, read_bundle
from kinegraph_export.model_card import main, model_card
from support.toy import TOY_BUNDLE

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_card_in_docs_is_that_of_the_default_bundle() -> None:
    assert (DOCS / f"{DEFAULT_BUNDLE.name}.md").read_text(encoding="utf-8") == model_card(read_bundle())


def test_a_card_has_licences_and_no_table_without_a_vocabulary(tmp_path: Path) -> None:
    main(["--bundle", str(TOY_BUNDLE), "--out", str(tmp_path / "card.md")])
    card = (tmp_path / "card.md").read_text(encoding="utf-8")
    manifest = read_bundle(TOY_BUNDLE).manifest
    assert card.startswith(f"# {manifest.name} {manifest.version}\n")
    assert manifest.licence.weights in card and "## Actions" not in card


def test_every_action_is_a_row_and_stays_in_it() -> None:
    bundle = read_bundle()
    assert bundle.vocabulary is not None
    rows = [line for line in model_card(bundle).splitlines() if line.startswith("| ") and not line.startswith("| name")]
    assert len(rows) == len(bundle.vocabulary.facts.phrases)
    for row, phrase in zip(rows, bundle.vocabulary.facts.phrases, strict=True):
        share = "" if phrase.recognised is None else f"{phrase.recognised:.2f}"
        cells = [cell.strip() for cell in row.strip("|").split(" | ")]
        assert cells[:2] == [phrase.name, str(phrase.clips)] and (cells[2] == share or phrase.kind == "style")
