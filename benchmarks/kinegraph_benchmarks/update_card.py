"""What was measured goes into the card that a bundle is exported with, and so into `kinegraph info`.

    python -m kinegraph_benchmarks.update_card --results results --card export/default_card.json

Reads evaluate.json, reconstruction.json, behaviour.json, masked_verbs.json and lengths.json of a folder and replaces
the card's "quality". All five have to be there and of one bundle.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

FILES = ("evaluate", "reconstruction", "behaviour", "masked_verbs", "lengths")
SPLITS = {"dev_test": "dev", "dev_compositional": "unseen_pairs"}
RATES = ("r_precision_1", "behaviour", "content", "style")
RATIOS = ("jerk", "foot_skate", "wave_speed")
CLAIMS = ("steps", "degrees", "height")
TOGETHER = {"in_order": "two_actions_in_order", "together": "two_actions_together"}
Figure = tuple[str, float, int]
"""Name, value, decimals."""


def quality(found: dict[str, Any]) -> dict[str, float]:
    """Figures of a card by name, of the JSON of `FILES`.

    Raises:
        ValueError: they are of more than one bundle.
    """
    bundles = {found["evaluate"]["model"], found["behaviour"]["bundle"], found["masked_verbs"]["model"],
               found["lengths"]["bundle"]}  # fmt: skip
    if len(bundles) > 1:
        raise ValueError(f"measured on more than one bundle: {', '.join(sorted(bundles))}")
    figures = [*evaluated(found["evaluate"]), *others(found)]
    return {name: round(float(value), decimals) for name, value, decimals in figures}


def evaluated(result: dict[str, Any]) -> Iterator[Figure]:
    """Of `evaluate.py`."""
    for split, label in SPLITS.items():
        parts = result["splits"][split]
        made, real = parts["generated"]["mean"], parts["captured"]
        for name in RATES:
            yield f"{label}_{name}", made[name]["mean"], 3
            yield f"{label}_{name}_captured", real[name]["mean"], 3
        yield f"{label}_fid", made["fid"]["mean"], 3
        for name in RATIOS:
            yield f"{label}_{name}_to_captured", made[name]["mean"] / real[name]["mean"], 2
        for claim in CLAIMS:
            yield f"{label}_claims_{claim}", made[f"claims_{claim}"]["mean"], 3
    for kind, label in TOGETHER.items():
        parts = result["two_actions"][kind]
        yield label, parts["generated"]["both_hold"]["mean"], 3
        yield f"{label}_captured", parts["captured"]["both_hold"]["mean"], 3


def others(found: dict[str, Any]) -> Iterator[Figure]:
    """Of the other files."""
    for part in ("local", "global"):
        yield f"autoencoder_val_{part}_mm", found["reconstruction"]["val"]["specific"][f"{part}_mm"], 1
    for source in ("generated", "captured"):
        yield f"behaviour_classes_{source}", found["behaviour"]["summary"][f"{source}_rate"], 2
    yield "behaviour_at_any_length", np.mean(list(found["lengths"]["summary"]["generated"].values())), 2
    for split, label in SPLITS.items():
        rates = found["masked_verbs"]["splits"][split]
        for kind in rates["whole caption"]:
            ratio = rates["verbs masked"][kind] / rates["whole caption"][kind]
            yield f"{label}_verbs_masked_{kind.replace(' ', '_')}", ratio, 2


def main() -> int:
    """0: written; 2: something is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, required=True, help="folder of the JSON files")
    parser.add_argument("--card", type=Path, required=True, help="JSON whose quality is replaced")
    given = parser.parse_args()
    try:
        found = {name: json.loads((given.results / f"{name}.json").read_text(encoding="utf-8")) for name in FILES}
        card = json.loads(given.card.read_text(encoding="utf-8"))
        card["quality"] = quality(found)
    except (OSError, KeyError, ValueError) as error:
        print(f"card: error: {error}", file=sys.stderr)
        return 2
    given.card.write_text(json.dumps(card, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
