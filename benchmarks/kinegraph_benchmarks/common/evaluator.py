"""Embed captions and motions in the evaluator's common space, with numpy and onnxruntime alone.

The evaluator is a pair of encoders trained apart from the generator (`kinegraph_training.train_evaluator`), in the
role of TMR or of the text-motion encoders of HumanML3D: R-precision, FID and the other metrics are read off its
unit vectors.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnxruntime

from kinegraph.arrays import FloatArray
from kinegraph.bundle.reader import text_files_folder
from kinegraph.errors import BundleIntegrityError
from kinegraph.motion.features import features_from_joints
from kinegraph.text.tokenizer import CaptionTokenizer

FOLDER = Path(__file__).parents[2] / "evaluator"
MAX_FRAMES = 196
BATCH = 32


class Evaluator:
    """Motion and text encoder of one version; captions go through the default bundle's text encoder first.

    Args:
        folder: motion.onnx, text.onnx and evaluator.json with their SHA-256.
        text_files: folder of the tokenizer and the text encoder; None takes those of installed bundles.

    Raises:
        BundleIntegrityError: a graph is not the one that evaluator.json names.
    """

    def __init__(self, folder: Path = FOLDER, text_files: Path | None = None) -> None:
        card = json.loads((folder / "evaluator.json").read_text(encoding="utf-8"))
        files = {name: (folder / name).read_bytes() for name in card["sha256"]}
        for name, data in files.items():
            if hashlib.sha256(data).hexdigest() != card["sha256"][name]:
                raise BundleIntegrityError(f"{folder / name} is not the file of evaluator version {card['version']}")
        self.version: str = card["version"]
        self._mean, self._std = (np.array(card[name], dtype=np.float32) for name in ("mean", "std"))
        self._frames_per_token: int = card["frames_per_token"]
        self._motion_encoder, self._text_encoder = (_open_session(files[name]) for name in ("motion.onnx", "text.onnx"))
        text_files = text_files or text_files_folder()
        self._word_encoder = _open_session((text_files / "text_encoder.onnx").read_bytes())
        self._tokenizer = CaptionTokenizer((text_files / "tokenizer.json").read_bytes())

    def embed_motions(self, clips: Sequence[FloatArray]) -> FloatArray:
        """Embed n clips of joints (frames, 22, 3), metres, at 20 frames per second, as unit vectors (n, e)."""
        features = [(features_from_joints(clip[:MAX_FRAMES]) - self._mean) / self._std for clip in clips]
        return _embed(self._motion_encoder, features, self._frames_per_token)

    def embed_captions(self, captions: Sequence[str]) -> FloatArray:
        """Embed n captions as unit vectors (n, e)."""
        states: dict[str, FloatArray] = {}
        for caption in captions:
            if caption not in states:
                tokens = self._tokenizer.encode(caption)
                feeds = {"input_ids": tokens.ids[None], "attention_mask": tokens.mask[None]}
                # The evaluator was trained on states stored in half precision.
                states[caption] = self._word_encoder.run(["hidden"], feeds)[0][0].astype(np.float16).astype(np.float32)
        return _embed(self._text_encoder, [states[caption] for caption in captions], 1)


def _open_session(data: bytes) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])


def _embed(session: onnxruntime.InferenceSession, sequences: Sequence[FloatArray], multiple: int) -> FloatArray:
    """Encode sequences (s, width) of any length, padded in batches of similar length to a multiple of `multiple`."""
    by_length = np.argsort([len(sequence) for sequence in sequences], kind="stable")
    parts: list[FloatArray] = []
    for start in range(0, len(by_length), BATCH):
        batch = [sequences[index] for index in by_length[start : start + BATCH]]
        longest = -(-max(map(len, batch)) // multiple) * multiple
        tokens = np.zeros((len(batch), longest, batch[0].shape[1]), dtype=np.float32)
        mask = np.zeros((len(batch), longest), dtype=np.float32)
        for row, sequence in enumerate(batch):
            tokens[row, : len(sequence)], mask[row, : len(sequence)] = sequence, 1.0
        parts.append(session.run(["embedding"], {"tokens": tokens, "mask": mask})[0])
    embeddings = np.empty((len(sequences), parts[0].shape[1]), dtype=np.float32)
    embeddings[by_length] = np.concatenate(parts)
    return embeddings
