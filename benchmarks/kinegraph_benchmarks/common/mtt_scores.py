"""Score motions of timelines in MTT's way: semantics of each interval's crop, realism of the whole.

    R@1, R@3        how often the text of a crop is the nearest of all texts, or among the nearest three
    M2T, M2M        cosine of a crop with its text, and with that text's captured motion, moved to 0..1
    FID             of five crops of 5 s of each motion, beside captured motions
    transition      distance of the joints, in the frame of the body, from the frame before a moment at which an
                    interval begins or ends to the frame there (TEACH: Athanasiou et al., 2022)

STMC (Petrovich et al., 2024, section 5.1) embeds with TMR; here it is the evaluator of `common.evaluator`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.motion.skeleton import facing_angle
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.mtt_set import MttSet, MttTimeline
from kinegraph_benchmarks.common.predicates import FPS
from kinegraph_training.metrics import frechet_distance
from kinegraph_training.synthetic.compositions import rotate_about_y

CROPS: Final = 5
"""Crops of each motion that its realism is judged by."""
CROP_SECONDS: Final = 5.0
TOP: Final = 3


@dataclass(frozen=True)
class MttJudge:
    """Texts and captured motions of a set, embedded once."""

    mtt: MttSet
    evaluator: Evaluator
    texts: FloatArray
    """(n, e) unit vectors."""
    motions: FloatArray | None
    """(n, e) of the captured motion of each text; None where one is missing."""
    reference: FloatArray | None
    """(m, e) of captured motions, for the FID."""

    @classmethod
    def of(cls, mtt: MttSet, evaluator: Evaluator, captured: Sequence[FloatArray] = ()) -> MttJudge:
        """Embed a set.

        Args:
            mtt: texts and timelines.
            evaluator: of texts and motions.
            captured: joints (frames, 22, 3) for the FID; without any, the captured motions of the texts.
        """
        own = [text.motion for text in mtt.texts if text.motion is not None]
        motions = evaluator.embed_motions(own) if len(own) == len(mtt.texts) else None
        reference = evaluator.embed_motions(captured) if captured else motions
        texts = evaluator.embed_captions([text.text for text in mtt.texts])
        return cls(mtt, evaluator, texts, motions, reference)

    def score(self, motions: Sequence[FloatArray], *, whole: bool) -> dict[str, float]:
        """Score one motion for each timeline of the set.

        Args:
            motions: joints (frames, 22, 3) at 20 frames per second.
            whole: whether each text holds for the whole motion, as where one sentence or one composition made it.
        """
        pairs = list(zip(self.mtt.timelines, motions, strict=True))
        rows = [self.mtt.rows[text] for timeline, _ in pairs for text in timeline.texts]
        crops = [crop for timeline, joints in pairs for crop in crops_of(timeline, joints, whole=whole)]
        embedded = self.evaluator.embed_motions(crops)
        scores = self._semantics(embedded, np.array(rows))
        if self.reference is not None:
            real = self.evaluator.embed_motions([crop for _, joints in pairs for crop in random_crops(joints)])
            scores["fid"] = frechet_distance(real, self.reference)
        steps = [distances_at(joints, moments_of(timeline, len(joints), whole=whole)) for timeline, joints in pairs]
        scores["transition"] = float(np.concatenate(steps).mean())
        return scores

    def score_captured(self) -> dict[str, float]:
        """Score the captured motions of the texts themselves: what the best of models could come to."""
        assert self.motions is not None
        scores = self._semantics(self.motions, np.arange(len(self.texts)))
        own = [text.motion for text in self.mtt.texts if text.motion is not None]
        if self.reference is not None:
            crops = [crop for joints in own for crop in random_crops(joints)]
            scores["fid"] = frechet_distance(self.evaluator.embed_motions(crops), self.reference)
        scores["transition"] = float(np.concatenate([distances_at(one, quarters(len(one))) for one in own]).mean())
        return scores

    def _semantics(self, crops: FloatArray, rows: NDArray[np.int64]) -> dict[str, float]:
        """Compare embeddings of crops (k, e) with all texts; `rows` are those of their own."""
        nearness = crops @ self.texts.T
        own = nearness[np.arange(len(rows)), rows]
        rank = (nearness >= own[:, None]).sum(axis=1) - 1  # a text that is just as near counts against it
        scores = {
            "r_precision_1": float((rank < 1).mean()),
            "r_precision_3": float((rank < TOP).mean()),
            "motion_text_score": float((1 + own).mean() / 2),
        }
        if self.motions is not None:
            scores["motion_motion_score"] = float((1 + (crops * self.motions[rows]).sum(axis=1)).mean() / 2)
        return scores


def crops_of(timeline: MttTimeline, joints: FloatArray, *, whole: bool) -> list[FloatArray]:
    """Cut a motion to the interval of each text; with `whole` it is the whole motion of each."""
    if whole:
        return [joints] * 3
    bounds = [(round(each.start * FPS), round(each.end * FPS)) for each in timeline.intervals]
    return [joints[start : max(end, start + 2)] for start, end in bounds]


def random_crops(joints: FloatArray) -> list[FloatArray]:
    """Cut `CROPS` crops of `CROP_SECONDS` at random places, which are those of any motion of the same length."""
    frames = min(round(CROP_SECONDS * FPS), len(joints))
    starts = np.random.default_rng(0).integers(0, len(joints) - frames + 1, CROPS)
    return [joints[start : start + frames] for start in starts]


def moments_of(timeline: MttTimeline, frames: int, *, whole: bool) -> list[int]:
    """List the frames at which an interval begins or ends within a motion; quarters, where texts hold for all of it."""
    if whole:
        return quarters(frames)
    bounds = {round(moment * FPS) for each in timeline.intervals for moment in (each.start, each.end)}
    return sorted(frame for frame in bounds if 0 < frame < frames)


def quarters(frames: int) -> list[int]:
    """List the frames after one, two and three quarters."""
    return [frames // 4, frames // 2, 3 * frames // 4]


def distances_at(joints: FloatArray, moments: Sequence[int]) -> NDArray[np.float64]:
    """Measure the mean distance of the joints from the frame before each moment, in the frames of the body, metres."""
    local = rotate_about_y(joints - joints[:, :1], -facing_angle(joints))
    return np.array([np.linalg.norm(local[frame] - local[frame - 1], axis=-1).mean() for frame in moments])
