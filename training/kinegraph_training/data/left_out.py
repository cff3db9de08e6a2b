"""Which training clips are left out of judging models, so that every action has takes that its judge has not seen.

Splits are by take, and an action of few takes is in `train` only. A judge of motion (`train_evaluator`, benchmarks)
leaves some of these out itself. The choice depends on names alone, so that every command makes the same.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, Final

HELD_OUT: Final = ("val", "dev_test")
"""Splits of clips that no training sees."""
SHARE: Final = 0.2
"""Of an action's training clips that is left out at least."""
FEWEST: Final = 3
"""Clips that an action keeps at least; with fewer than twice as many, none is left out."""


def take_of(row: Mapping[str, Any]) -> str:
    """Name the take of a clip: windows of one recording share it."""
    parts = [str(row.get(key, "")) for key in ("group", "take", "source_file")]
    return "/".join(parts) if any(parts) else str(row["id"])


def left_out_clips(index: Mapping[str, Mapping[str, Any]]) -> dict[str, bool]:
    """Choose the training clips that a judge must not see, of each action that has no clip in `HELD_OUT`.

    Whole takes are left out, in an order of their names' hashes, until they have `SHARE` of the clips. An action with a
    single take loses its last windows: they are of the same recording as what is kept, which makes it easier.

    Args:
        index: rows of index.jsonl by id: split, content, and take, group or source_file.

    Returns:
        By id of the clip: whether its whole take is left out.
    """
    rows = [row for row in index.values() if row.get("content") and row.get("clean", True)]
    judged = {row["content"] for row in rows if row["split"] in HELD_OUT}
    by_action: dict[str, dict[str, list[str]]] = {}
    for row in rows:
        if row["split"] == "train" and row["content"] not in judged:
            by_action.setdefault(row["content"], {}).setdefault(take_of(row), []).append(row["id"])
    chosen: dict[str, bool] = {}
    for takes in by_action.values():
        chosen |= _choose(takes)
    return chosen


def _choose(takes: Mapping[str, list[str]]) -> dict[str, bool]:
    """Choose clips of one action, takes by name."""
    total = sum(map(len, takes.values()))
    if total < 2 * FEWEST:
        return {}
    if len(takes) == 1:
        windows = next(iter(takes.values()))
        return dict.fromkeys(windows[-max(1, round(SHARE * total)) :], False)
    chosen: list[str] = []
    for take in sorted(takes, key=lambda name: hashlib.sha256(name.encode()).digest()):
        if len(chosen) < SHARE * total and total - len(chosen) - len(takes[take]) >= FEWEST:
            chosen += takes[take]
    return dict.fromkeys(chosen, True)
