"""Captions that a training run shows its models, with labels, for the vocabulary of the bundle.

A run stores those of all its clips, synthetic ones included (`captions.jsonl`); a data folder holds those of the
recorded ones.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from kinegraph.errors import InvalidInputError
from kinegraph_training.data.clips import (
    MIRRORED,
    MotionClip,
    mirrored_caption,
    mirrored_label,
    read_jsonl,
    split_label,
)

FILE: Final = "captions.jsonl"
COUNTED: Final = ("bent", "gestures")
"""Synthetic clips that show what no recording may show (`MotionClip.made_by`); they count as recorded ones do."""


@dataclass(frozen=True)
class ShownCaptions:
    """Captions of one clip."""

    captions: tuple[str, ...]
    actions: tuple[str, ...]
    """Label of each action; none where the data has no labels."""
    style: str
    recorded: bool
    """Whether it counts as a clip of its actions: false for what was composed, cut or mirrored from others."""


def write_shown_captions(run: Path, clips: Iterable[MotionClip], recorded: Iterable[str]) -> None:
    """Write the captions of all training clips into the folder of a run.

    Args:
        run: its folder.
        clips: all that training draws from.
        recorded: ids of those that were recorded.
    """
    ids = frozenset(recorded)
    rows = (
        {
            "captions": clip.captions,
            "actions": clip.actions,
            "style": clip.style,
            "recorded": clip.id in ids or (clip.made_by in COUNTED and not clip.id.endswith(MIRRORED)),
        }
        for clip in clips
    )
    run.mkdir(parents=True, exist_ok=True)
    with (run / FILE).open("w", encoding="utf-8") as file:
        file.writelines(json.dumps(row, ensure_ascii=False) + "\n" for row in rows)


def read_shown_captions(run: Path) -> list[ShownCaptions]:
    """Read what `write_shown_captions` wrote; a run of an older version has none.

    Raises:
        InvalidInputError: the file holds something else.
    """
    if not (run / FILE).is_file():
        return []
    lines = (run / FILE).read_text(encoding="utf-8").split("\n")
    try:
        rows = [json.loads(line) for line in lines if line]
        return [
            ShownCaptions(tuple(row["captions"]), tuple(row["actions"]), str(row["style"]), bool(row["recorded"]))
            for row in rows
        ]
    except (ValueError, TypeError, KeyError) as error:
        raise InvalidInputError(f"{run / FILE} holds no captions of a training run: {error!r}") from error


def read_data_captions(folder: Path) -> list[ShownCaptions]:
    """Read the captions of a data folder's training clips, and of their mirror images; no motion is read.

    Raises:
        InvalidInputError: a file is missing, or no clip is of the split `train`.
    """
    captions, index = read_jsonl(folder / "captions.jsonl"), read_jsonl(folder / "index.jsonl")
    shown = []
    for name, row in index.items():
        if row.get("split") != "train" or not row.get("clean", True):
            continue
        texts = tuple(captions.get(name, {}).get("captions", ()))
        label = row.get("content", "")
        actions = split_label(label)
        clip = ShownCaptions(texts, actions, row.get("style_canon", ""), recorded=True)
        shown += [clip, _mirrored(clip)]
    if not shown:
        raise InvalidInputError(f"{folder} has no training clips; name a folder that kinegraph_training.prepare wrote")
    return shown


def _mirrored(clip: ShownCaptions) -> ShownCaptions:
    return ShownCaptions(
        tuple(map(mirrored_caption, clip.captions)), tuple(map(mirrored_label, clip.actions)), clip.style, False
    )
