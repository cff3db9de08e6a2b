"""The card of a bundle is filled from what was measured."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from kinegraph_benchmarks import update_card as card

ROOT = Path(__file__).resolve().parents[2]
MEASURES = ("r_precision_1", "behaviour", "content", "style", "fid", "jerk", "foot_skate", "wave_speed",
            "claims_steps", "claims_degrees", "claims_height")  # fmt: skip


def results(bundle: str = "edge 9") -> dict[str, Any]:
    made, real = ({name: {"mean": value + place / 100} for place, name in enumerate(MEASURES)} for value in (0.4, 0.8))
    both = {kind: {part: {"both_hold": {"mean": 0.75}} for part in ("generated", "captured")} for kind in card.TOGETHER}
    verbs = {
        "whole caption": {"direction": 0.8, "body part": 1.0},
        "verbs masked": {"direction": 0.6, "body part": 1.0},
    }
    return {
        "evaluate": {
            "model": bundle,
            "splits": {split: {"generated": {"mean": made}, "captured": real} for split in card.SPLITS},
            "two_actions": both,
        },
        "reconstruction": {"val": {"specific": {"local_mm": 8.43, "global_mm": 25.06}}},
        "behaviour": {"bundle": bundle, "summary": {"generated_rate": 0.987, "captured_rate": 0.949}},
        "masked_verbs": {"model": bundle, "splits": dict.fromkeys(card.SPLITS, verbs)},
        "lengths": {"bundle": bundle, "summary": {"generated": {"2": 1.0, "4": 0.9}}},
    }


def test_figures_are_those_measured() -> None:
    found = card.quality(results())
    assert found["dev_r_precision_1"] == 0.4 and found["dev_r_precision_1_captured"] == 0.8
    assert found["unseen_pairs_content"] == 0.42 and found["dev_fid"] == 0.44
    assert found["dev_jerk_to_captured"] == round(0.45 / 0.85, 2)
    assert found["two_actions_in_order"] == 0.75 and found["autoencoder_val_local_mm"] == 8.4
    assert found["behaviour_at_any_length"] == 0.95 and found["unseen_pairs_verbs_masked_direction"] == 0.75


def test_the_default_card_has_these_names() -> None:
    names = set(json.loads((ROOT / "export" / "default_card.json").read_text(encoding="utf-8"))["quality"])
    assert names <= set(card.quality(results()))


def test_figures_of_two_bundles_are_not_mixed() -> None:
    mixed = results() | {"behaviour": results("edge 8")["behaviour"]}
    with pytest.raises(ValueError, match="more than one bundle: edge 8, edge 9"):
        card.quality(mixed)


def test_only_the_quality_of_the_card_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "card.json"
    path.write_text(json.dumps({"name": "edge", "quality": {"old": 1.0}}))
    monkeypatch.setattr(sys, "argv", ["card.py", "--results", str(tmp_path), "--card", str(path)])
    assert card.main() == 2 and "evaluate.json" in capsys.readouterr().err
    assert json.loads(path.read_text())["quality"] == {"old": 1.0}
    for name, found in results().items():
        (tmp_path / f"{name}.json").write_text(json.dumps(found))
    assert card.main() == 0
    assert json.loads(path.read_text()) == {"name": "edge", "quality": card.quality(results())}
