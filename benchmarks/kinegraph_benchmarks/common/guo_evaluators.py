"""The evaluators of Guo et al. (2022) on onnxruntime: embeddings of captions and of motion features.

`kinegraph_export.import_evaluators` writes the three networks from the user's download. Words come from the GloVe files
of the same download, features in the layout of HumanML3D or KIT-ML.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import onnxruntime

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError

PARTS: Final = ("movement", "motion", "text")
CONTACTS: Final = 4
"""Last columns of the features, which the evaluators do not see."""
UNIT: Final = 4
"""Frames of a movement."""
MAX_WORDS: Final = 20
"""Of a caption; two markers stand around them."""
TAGS: Final = (
    *("VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV"),
    *("Loc_VIP", "Body_VIP", "Obj_VIP", "Act_VIP", "Desc_VIP", "OTHER"),
)
"""Parts of speech and kinds of key words, in the order of the text encoder's input."""
_KEY_WORDS: Final = {
    "Loc_VIP": "left right clockwise counterclockwise anticlockwise forward back backward up down straight curve",
    "Body_VIP": "arm chin foot feet face hand mouth leg waist eye knee shoulder thigh",
    "Obj_VIP": "stair dumbbell chair window floor car ball handrail baseball basketball",
    "Act_VIP": "walk run swing pick bring kick put squat throw hop dance jump turn stumble stop sit lift lower raise "
    "wash stand kneel stroll rub bend balance flap jog shuffle lean rotate spin spread climb",
    "Desc_VIP": "slowly carefully fast careful slow quickly happy angry sad happily angrily sadly",
}
KIND_OF_WORD: Final = {word: kind for kind, words in _KEY_WORDS.items() for word in words.split()}
"""Words whose kind stands in place of their part of speech, as the evaluators were trained."""
PADDED: Final = 196
"""Frames that motions are padded to with zeros, as in the published code: the last movement sees the padding."""
BATCH: Final = 64


class _PlainUnpickler(pickle.Unpickler):
    """Reader of lists, dictionaries, texts and numbers, which runs no code."""

    def find_class(self, module: str, name: str) -> Any:
        raise pickle.UnpicklingError(f"it holds {module}.{name}")


@dataclass(frozen=True)
class WordVectors:
    """GloVe vectors of the words that captions have."""

    vectors: FloatArray
    """(words, 300)."""
    rows: Mapping[str, int]

    @classmethod
    def read(cls, folder: Path) -> WordVectors:
        """Read our_vab_data.npy, our_vab_words.pkl and our_vab_idx.pkl of the published download.

        Raises:
            InvalidInputError: a file is missing or holds something else.
        """
        try:
            vectors = np.load(folder / "our_vab_data.npy", allow_pickle=False)
            tables = []
            for name in ("our_vab_words.pkl", "our_vab_idx.pkl"):
                with (folder / name).open("rb") as file:
                    tables.append(_plain(file))
            words, index = tables
            rows = {str(word): int(index[word]) for word in words}
        except (OSError, ValueError, EOFError, pickle.UnpicklingError, KeyError, TypeError, AttributeError) as error:
            raise InvalidInputError(
                f"{folder} cannot be read as GloVe vectors ({error}); --glove names the published folder, with "
                "our_vab_data.npy, our_vab_words.pkl and our_vab_idx.pkl"
            ) from error
        if vectors.ndim != 2 or "unk" not in rows or max(rows.values()) >= len(vectors):
            raise InvalidInputError(
                f"{folder}: the vectors are {vectors.shape}, of other words than the list, or lack unk"
            )
        return cls(vectors.astype(np.float32), rows)

    def encode(self, tokens: Sequence[str]) -> tuple[FloatArray, FloatArray, int]:
        """Encode the tokens of a caption, such as `walk/VERB`.

        Returns:
            Word vectors (22, 300), tags (22, 15), and how many of them are real.
        """
        kept = ["sos/OTHER", *tokens[:MAX_WORDS], "eos/OTHER"]
        padded = [*kept, *["unk/OTHER"] * (MAX_WORDS + 2 - len(kept))]
        vectors = np.empty((len(padded), self.vectors.shape[1]), dtype=np.float32)
        tags = np.zeros((len(padded), len(TAGS)), dtype=np.float32)
        for place, token in enumerate(padded):
            word, _, part = token.rpartition("/")
            known = word in self.rows
            vectors[place] = self.vectors[self.rows[word if known else "unk"]]
            tag = KIND_OF_WORD.get(word, part) if known else "OTHER"
            tags[place, TAGS.index(tag if tag in TAGS else "OTHER")] = 1.0
        return vectors, tags, len(kept)


def _plain(file: BinaryIO) -> Any:
    return _PlainUnpickler(file).load()


class GuoEvaluators:
    """The three networks, with the normalisation that they were trained under.

    Args:
        folder: of movement.onnx, motion.onnx and text.onnx.
        statistics: folder of the evaluators' own mean.npy and std.npy.
        words: of captions.

    Raises:
        InvalidInputError: a file is missing, or the statistics are of other features.
    """

    def __init__(self, folder: Path, statistics: Path, words: WordVectors) -> None:
        missing = [f"{part}.onnx" for part in PARTS if not (folder / f"{part}.onnx").is_file()]
        if missing:
            raise InvalidInputError(
                f"{folder} lacks {', '.join(missing)}; write them with `python -m kinegraph_export.import_evaluators`"
            )
        files = {part: (folder / f"{part}.onnx").read_bytes() for part in PARTS}
        self.version = hashlib.sha256(b"".join(files.values())).hexdigest()[:12]
        self._sessions = {
            part: onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"]) for part, data in files.items()
        }
        self.words = words
        self.features = int(self._sessions["movement"].get_inputs()[0].shape[2]) + CONTACTS
        self._mean, self._std = (self._read(statistics, name) for name in ("mean.npy", "std.npy"))

    def _read(self, folder: Path, name: str) -> FloatArray:
        try:
            array = np.load(folder / name, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise InvalidInputError(
                f"{folder / name} cannot be read: {error}; --evaluator-stats names the evaluators' own statistics, "
                "such as t2m/Comp_v6_KLD005/meta"
            ) from error
        if array.shape != (self.features,) or not np.isfinite(array).all():
            raise InvalidInputError(f"{folder / name} is {array.shape}; these evaluators have {self.features} features")
        return np.asarray(array, dtype=np.float32)

    def embed_motions(self, motions: Sequence[FloatArray]) -> FloatArray:
        """Embed motions given as features (frames, F), not normalised, of four frames or more: (motions, e)."""
        parts: list[FloatArray] = []
        for start in range(0, len(motions), BATCH):
            batch = [(rows - self._mean) / self._std for rows in motions[start : start + BATCH]]
            lengths = np.array([len(rows) // UNIT for rows in batch], dtype=np.int32)
            longest = max(PADDED, *map(len, batch))
            padded = np.zeros((len(batch), longest, self.features - CONTACTS), dtype=np.float32)
            for row, features in enumerate(batch):
                padded[row, : len(features)] = features[:, :-CONTACTS]
            (movements,) = self._sessions["movement"].run(None, {"features": padded})
            (embedded,) = self._sessions["motion"].run(None, {"tokens": movements, "lengths": lengths})
            parts.append(embedded)
        return np.concatenate(parts)

    def embed_texts(self, captions: Sequence[Sequence[str]]) -> FloatArray:
        """Embed captions given as their tokens, such as `walk/VERB`: (captions, e)."""
        parts: list[FloatArray] = []
        for start in range(0, len(captions), BATCH):
            encoded = [self.words.encode(tokens) for tokens in captions[start : start + BATCH]]
            vectors, tags, lengths = zip(*encoded, strict=True)
            inputs = {"tokens": np.stack(vectors), "tags": np.stack(tags), "lengths": np.array(lengths, dtype=np.int32)}
            (embedded,) = self._sessions["text"].run(None, inputs)
            parts.append(embedded)
        return np.concatenate(parts)
