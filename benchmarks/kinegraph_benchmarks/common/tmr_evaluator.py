"""TMR (Petrovich et al., ICCV 2023) on onnxruntime: sentences and motions in one space, compared by their angle.

`kinegraph_export.import_tmr` writes both networks from the user's download. Embeddings have the length 1, so that the
nearest by angle is the nearest by distance.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import onnxruntime

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.text.tokenizer import CaptionTokenizer
from kinegraph_training.metrics import r_precision

FILES: Final = ("motion.onnx", "text.onnx", "tokenizer.json")
BATCH: Final = 64
COLUMNS: Final = {
    "tmr_r_precision_1": "TMR R@1", "tmr_r_precision_2": "TMR R@2", "tmr_r_precision_3": "TMR R@3",
    "tmr_m2t": "TMR M2T", "tmr_m2m": "TMR M2M",
}  # fmt: skip
"""What `score` measures -> heading."""


class TmrEvaluator:
    """Both encoders, with the tokenizer of the sentences.

    Args:
        folder: that import_tmr wrote.

    Raises:
        InvalidInputError: a file is missing.
    """

    def __init__(self, folder: Path) -> None:
        missing = [name for name in FILES if not (folder / name).is_file()]
        if missing:
            raise InvalidInputError(
                f"{folder} lacks {', '.join(missing)}; write them with `python -m kinegraph_export.import_tmr`"
            )
        files = {name: (folder / name).read_bytes() for name in FILES}
        self.version = hashlib.sha256(b"".join(files.values())).hexdigest()[:12]
        self._motion, self._text = (
            onnxruntime.InferenceSession(files[name], providers=["CPUExecutionProvider"]) for name in FILES[:2]
        )
        self._tokenizer = CaptionTokenizer(files[FILES[2]])
        self.features = int(self._motion.get_inputs()[0].shape[2])

    def embed_motions(self, motions: Sequence[FloatArray]) -> FloatArray:
        """Embed motions given as features (frames, 263), not normalised: (motions, e), each of length 1."""
        parts = []
        for start in range(0, len(motions), BATCH):
            batch = motions[start : start + BATCH]
            lengths = np.array([len(rows) for rows in batch])
            features = np.zeros((len(batch), lengths.max(), self.features), dtype=np.float32)
            for row, rows in enumerate(batch):
                features[row, : len(rows)] = rows
            parts.append(self._motion.run(None, {"features": features, "lengths": lengths})[0])
        return _unit(np.concatenate(parts))

    def embed_sentences(self, sentences: Sequence[str]) -> FloatArray:
        """Embed sentences: (sentences, e), each of length 1."""
        parts = []
        for start in range(0, len(sentences), BATCH):
            tokens = [self._tokenizer.encode(sentence).ids for sentence in sentences[start : start + BATCH]]
            lengths = np.array([len(ids) for ids in tokens])
            mask = (np.arange(lengths.max()) < lengths[:, None]).astype(np.int64)
            padded = np.zeros(mask.shape, dtype=np.int64)
            padded[mask == 1] = np.concatenate(tokens)
            parts.append(self._text.run(None, {"input_ids": padded, "attention_mask": mask})[0])
        return _unit(np.concatenate(parts))


def _unit(rows: FloatArray) -> FloatArray:
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)


def nearness(a: FloatArray, b: FloatArray) -> float:
    """Compute the mean nearness of embeddings (n, e) of length 1, row by row: 1 in one direction, 0 in opposite ones.

    This is (1 + cos) / 2, as TMR scores a pair.
    """
    return float((1.0 + (a * b).sum(axis=1).mean()) / 2.0)


def score(told: FloatArray, moved: FloatArray, captured: FloatArray, groups: Sequence[np.ndarray]) -> dict[str, float]:
    """Score motions by TMR.

    Args:
        told: (n, e) embeddings of the sentences.
        moved: (n, e) embeddings of the motions.
        captured: (n, e) embeddings of the captured clips of these sentences.
        groups: rows among which R-precision looks for the right motion.

    Returns:
        By name of `COLUMNS`: R-precision, and nearness of the motions to their sentences (M2T) and to the captured
        clips (M2M).
    """
    ranks = np.mean([r_precision(told[rows], moved[rows]) for rows in groups], axis=0)
    return {
        **{f"tmr_r_precision_{rank + 1}": float(value) for rank, value in enumerate(ranks)},
        "tmr_m2t": nearness(moved, told),
        "tmr_m2m": nearness(moved, captured),
    }
