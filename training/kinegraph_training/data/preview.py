"""A contact sheet of prepared clips: what was understood of each, to be looked at before training."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.errors import MissingExtraError
from kinegraph.files import write_atomically
from kinegraph_training.data.folder import PreparedClip

MOST_CLIPS: Final = 24
"""Clips on a sheet, evenly chosen."""


def write_preview(path: Path, clips: Sequence[PreparedClip], fps: float) -> int:
    """Draw up to `MOST_CLIPS` clips, one a row, and write them as PNG.

    Returns:
        Number of clips drawn.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: the file cannot be written.
    """
    try:
        from matplotlib.figure import Figure

        from kinegraph.formats.contact_sheet import POSES, draw_row, png_bytes, title_line
    except ImportError as error:
        raise MissingExtraError('--preview needs matplotlib: pip install "kinegraph[plot]"') from error
    chosen = [clips[index] for index in np.unique(np.linspace(0, len(clips) - 1, MOST_CLIPS).round().astype(int))]
    figure = Figure(figsize=(1.4 * (POSES + 1.5), 2.7 * len(chosen)), dpi=80)
    rows = figure.subplots(len(chosen), POSES + 1, width_ratios=[1.0] * POSES + [1.5], squeeze=False)
    for row, clip in zip(rows, chosen, strict=True):
        draw_row(row, clip.joints, fps)
        row[0].set_title(title_line(f"{clip.id}: {clip.captions[0]}"), fontsize=10, loc="left")
    figure.subplots_adjust(
        left=0.01, right=0.97, bottom=0.2 / len(rows), top=1 - 0.3 / len(rows), wspace=0.02, hspace=0.25
    )
    write_atomically(path, png_bytes(figure))
    return len(chosen)
