"""The evaluator at work: captions and motions as unit vectors of one space, with numpy and onnxruntime alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnxruntime

from kinegraph.arrays import FloatArray
from kinegraph.bundle.reader import DEFAULT_BUNDLE
from kinegraph.errors import BundleIntegrityError
from kinegraph.motion.features import features_from_joints
from kinegraph.text.tokenizer import CaptionTokenizer

FOLDER = Path(__file__).parents[2] / "evaluator"
MAX_FRAMES = 196
BATCH = 32


class Evaluator:
    """Motion and text encoder of one version; captions go through the default bundle's text encoder first."""

    def __init__(self, folder: Path = FOLDER, text_files: Path = DEFAULT_BUNDLE) -> None:
        card = json.loads((folder / "evaluator.json").read_text(encoding="utf-8"))
        files = {name: (folder / name).read_bytes() for name in card["sha256"]}
        for name, data in files.items():
            if hashlib.sha256(data).hexdigest() != card["sha256"][name]:
                raise BundleIntegrityError(f"{folder / name} is not the file of evaluator version {card['version']}")
        self.version: str = card["version"]
        self._mean, self._std = (np.array(card[name], dtype=np.float32) for name in ("mean", "std"))
        self._group: int = card["frames_per_token"]
        self._motion, self._text = (_session(files[name]) for name in ("motion.onnx", "text.onnx"))
        self._states = _session((text_files / "text_encoder.onnx").read_bytes())
        self._tokenizer = CaptionTokenizer((text_files / "tokenizer.json").read_bytes())

    def motions(self, clips: Sequence[FloatArray]) -> FloatArray:
        """Joints (frames, 22, 3) of n clips -> (n, e)."""
        rows = [(features_from_joints(clip[:MAX_FRAMES]) - self._mean) / self._std for clip in clips]
        return _embedded(self._motion, rows, self._group)

    def captions(self, texts: Sequence[str]) -> FloatArray:
        """n captions -> (n, e)."""
        known: dict[str, FloatArray] = {}
        for text in texts:
            if text not in known:
                tokens = self._tokenizer.encode(text)
                feeds = {"input_ids": tokens.ids[None], "attention_mask": tokens.mask[None]}
                # As in training: states are kept in half precision.
                known[text] = self._states.run(["hidden"], feeds)[0][0].astype(np.float16).astype(np.float32)
        return _embedded(self._text, [known[text] for text in texts], 1)


def _session(data: bytes) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])


def _embedded(session: onnxruntime.InferenceSession, rows: Sequence[FloatArray], multiple: int) -> FloatArray:
    """Sequences of any length, in batches of like length."""
    order = np.argsort([len(row) for row in rows], kind="stable")
    parts: list[FloatArray] = []
    for start in range(0, len(order), BATCH):
        batch = [rows[number] for number in order[start : start + BATCH]]
        longest = -(-max(map(len, batch)) // multiple) * multiple
        tokens = np.zeros((len(batch), longest, batch[0].shape[1]), dtype=np.float32)
        mask = np.zeros((len(batch), longest), dtype=np.float32)
        for place, row in enumerate(batch):
            tokens[place, : len(row)], mask[place, : len(row)] = row, 1.0
        parts.append(session.run(["embedding"], {"tokens": tokens, "mask": mask})[0])
    found = np.empty((len(rows), parts[0].shape[1]), dtype=np.float32)
    found[order] = np.concatenate(parts)
    return found
