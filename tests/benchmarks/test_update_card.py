"""The quality of a bundle's card comes from the results of the benchmarks."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from kinegraph_benchmarks import update_card

ROOT = Path(__file__).resolve().parents[2]
METRICS = ("r_precision_1", "behaviour", "content", "style", "fid", "jerk", "foot_skate", "wave_speed",
            "claims_steps", "claims_degrees", "claims_height")  # fmt: skip


def results(bundle: str = "edge 9") -> dict[str, Any]:
    generated, captured = (
        {name: {"mean": value + index / 100} for index, name in enumerate(METRICS)} for value in (0.4, 0.8)
    )
    both = {
        kind: {part: {"both_hold": {"mean": 0.75}} for part in ("generated", "captured")}
        for kind in update_card.CARD_TWO_ACTIONS
    }
    verbs = {
        "whole caption": {"direction": 0.8, "body part": 1.0},
        "verbs masked": {"direction": 0.6, "body part": 1.0},
    }
    return {
        "evaluate": {
            "model": bundle,
            "splits": {
                split: {"generated": {"mean": generated}, "captured": captured} for split in update_card.CARD_SPLITS
            },
            "two_actions": both,
        },
        "reconstruction": {"val": {"specific": {"local_mm": 8.43, "global_mm": 25.06}}},
        "behaviour": {"bundle": bundle, "summary": {"generated_rate": 0.987, "captured_rate": 0.949}},
        "masked_verbs": {"model": bundle, "splits": dict.fromkeys(update_card.CARD_SPLITS, verbs)},
        "lengths": {"bundle": bundle, "summary": {"generated": {"2": 1.0, "4": 0.9}}},
    }


def test_figures_are_those_measured() -> None:
    quality = update_card.card_quality(results())
    assert quality["dev_r_precision_1"] == 0.4 and quality["dev_r_precision_1_captured"] == 0.8
    assert quality["unseen_pairs_content"] == 0.42 and quality["dev_fid"] == 0.44
    assert quality["dev_jerk_to_captured"] == round(0.45 / 0.85, 2)
    assert quality["two_actions_in_order"] == 0.75 and quality["autoencoder_val_local_mm"] == 8.4
    assert quality["behaviour_at_any_length"] == 0.95 and quality["unseen_pairs_verbs_masked_direction"] == 0.75


def test_the_card_has_these_names() -> None:
    names = set(json.loads((ROOT / "export" / "studio_card.json").read_text(encoding="utf-8"))["quality"])
    assert names <= set(update_card.card_quality(results()))


def test_figures_of_two_bundles_are_not_mixed() -> None:
    mixed = results() | {"behaviour": results("edge 8")["behaviour"]}
    with pytest.raises(ValueError, match="more than one bundle: edge 8, edge 9"):
        update_card.card_quality(mixed)


def test_only_the_quality_of_the_card_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "card.json"
    path.write_text(json.dumps({"name": "edge", "quality": {"old": 1.0}}))
    monkeypatch.setattr(sys, "argv", ["update_card", "--results", str(tmp_path), "--card", str(path)])
    assert update_card.main() == 2 and "evaluate.json" in capsys.readouterr().err
    assert json.loads(path.read_text())["quality"] == {"old": 1.0}
    for name, result in results().items():
        (tmp_path / f"{name}.json").write_text(json.dumps(result))
    assert update_card.main() == 0
    assert json.loads(path.read_text()) == {"name": "edge", "quality": update_card.card_quality(results())}
