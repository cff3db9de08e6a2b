"""How often each clip is drawn in training, so that what few clips show is learnt too."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable

import numpy as np

from kinegraph_training.config import DataConfig
from kinegraph_training.data.clips import MotionClip


def sampling_weights(clips: Iterable[MotionClip], config: DataConfig) -> np.ndarray:
    """Compute how often each clip is drawn, (clips,), by what made it and by what it shows.

    What made a clip has the share of `DataConfig.draws`. Within it, an action has a share by a power of its number of
    clips, and within an action each style likewise: an action recorded in many styles is not drawn more often for it.
    No action has more than `label_cap`: what it has too much is shared by the others.
    """
    told = [(clip.made_by, clip.action, clip.style, clip.action or clip.id) for clip in clips]
    kinds = np.array([made_by for made_by, *_ in told])
    actions, styles = (Counter[tuple[str, ...]](clip[:size] for clip in told) for size in (2, 3))
    powers = {group: float(count**config.label_power) for group, count in (actions | styles).items()}
    of_styles: defaultdict[tuple[str, ...], float] = defaultdict(float)
    for style in styles:
        of_styles[style[:2]] += powers[style]
    weights = np.array([powers[clip[:2]] * powers[clip[:3]] / of_styles[clip[:2]] / styles[clip[:3]] for clip in told])
    often = tuple(config.often)
    weights *= [config.often_weight if often and action.startswith(often) else 1.0 for _, action, *_ in told]
    shares = {kind: config.draws.get(kind, float(np.mean(kinds == kind))) for kind in set(kinds.tolist())}
    shares[""] = max(1.0 - sum(share for kind, share in shares.items() if kind), 0.0)
    for kind, share in shares.items():
        of_kind = kinds == kind
        weights[of_kind] *= share / max(weights[of_kind].sum(), 1e-12)
    labels, index = np.unique([label for *_, label in told], return_inverse=True)
    for _ in range(10):  # capping one action lifts the others, which may pass the cap then
        totals = np.bincount(index, weights, len(labels))
        weights *= np.minimum(1.0, config.label_cap / totals.clip(min=1e-12))[index]
        weights /= weights.sum()
    return weights
