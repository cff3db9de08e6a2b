"""Copy measured figures into the card that a bundle is exported with, and so into `kinegraph info`.

    python -m kinegraph_benchmarks.update_card --results results --card export/studio_card.json

Reads evaluate.json, reconstruction.json, behaviour.json, masked_verbs.json and lengths.json of a folder and replaces
the card's "quality". All five must be there and come from the same bundle.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph_benchmarks.common.arguments import benchmark_parser

RESULTS = ("evaluate", "reconstruction", "behaviour", "masked_verbs", "lengths")
CARD_SPLITS = {"dev_test": "dev", "dev_compositional": "unseen_pairs"}
RATES = ("r_precision_1", "behaviour", "content", "style")
RATIOS = ("jerk", "foot_skate", "wave_speed")
CLAIMS = ("steps", "degrees", "height")
CARD_TWO_ACTIONS = {"in_order": "two_actions_in_order", "together": "two_actions_together"}
Figure = tuple[str, float, int]
"""Name, value, decimals."""


def card_quality(results: dict[str, Any]) -> dict[str, float]:
    """Select and round the figures of a card by name from the results of `RESULTS`.

    Raises:
        ValueError: they are of more than one bundle.
    """
    bundles = {results["evaluate"]["model"], results["behaviour"]["bundle"], results["masked_verbs"]["model"],
               results["lengths"]["bundle"]}  # fmt: skip
    if len(bundles) > 1:
        raise ValueError(f"measured on more than one bundle: {', '.join(sorted(bundles))}")
    figures = [*evaluation_figures(results["evaluate"]), *other_figures(results)]
    return {name: round(float(value), decimals) for name, value, decimals in figures}


def evaluation_figures(result: dict[str, Any]) -> Iterator[Figure]:
    """Select the figures of `quality.evaluate`."""
    for split, label in CARD_SPLITS.items():
        parts = result["splits"][split]
        generated, captured = parts["generated"]["mean"], parts["captured"]
        for name in RATES:
            yield f"{label}_{name}", generated[name]["mean"], 3
            yield f"{label}_{name}_captured", captured[name]["mean"], 3
        yield f"{label}_fid", generated["fid"]["mean"], 3
        for name in RATIOS:
            yield f"{label}_{name}_to_captured", generated[name]["mean"] / captured[name]["mean"], 2
        for claim in CLAIMS:
            yield f"{label}_claims_{claim}", generated[f"claims_{claim}"]["mean"], 3
    for kind, label in CARD_TWO_ACTIONS.items():
        parts = result["two_actions"][kind]
        yield label, parts["generated"]["both_hold"]["mean"], 3
        yield f"{label}_captured", parts["captured"]["both_hold"]["mean"], 3


def other_figures(results: dict[str, Any]) -> Iterator[Figure]:
    """Select the figures of the other benchmarks."""
    for part in ("local", "global"):
        yield f"autoencoder_val_{part}_mm", results["reconstruction"]["val"]["specific"][f"{part}_mm"], 1
    for source in ("generated", "captured"):
        yield f"behaviour_classes_{source}", results["behaviour"]["summary"][f"{source}_rate"], 2
    yield "behaviour_at_any_length", np.mean(list(results["lengths"]["summary"]["generated"].values())), 2
    for split, label in CARD_SPLITS.items():
        rates = results["masked_verbs"]["splits"][split]
        for kind in rates["whole caption"]:
            ratio = rates["verbs masked"][kind] / rates["whole caption"][kind]
            yield f"{label}_verbs_masked_{kind.replace(' ', '_')}", ratio, 2


def main() -> int:
    """Run the command line: 0 if the card was written, 2 if something is missing."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--results", type=Path, required=True, help="folder of the JSON files")
    parser.add_argument("--card", type=Path, required=True, help="JSON whose quality is replaced")
    options = parser.parse_args()
    try:
        results = {name: json.loads((options.results / f"{name}.json").read_text(encoding="utf-8")) for name in RESULTS}
        card = json.loads(options.card.read_text(encoding="utf-8"))
        card["quality"] = card_quality(results)
    except (OSError, KeyError, ValueError) as error:
        print(f"update_card: error: {error}", file=sys.stderr)
        return 2
    options.card.write_text(json.dumps(card, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
