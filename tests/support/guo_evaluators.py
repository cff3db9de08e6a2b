"""Made evaluators of Guo et al. in their published layout, with random weights; GloVe files of a few words."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np

WORDS = ("sos", "eos", "unk", "a", "person", "walk", "forward", "someone", "turn", "left")


def evaluator_tensors(features: int = 259, words: int = 300) -> dict[str, np.ndarray]:
    """Weights under the names of GraphMotion's checkpoints, small and random."""
    rng = np.random.Generator(np.random.PCG64(4))

    def draw(*shape: int) -> np.ndarray:
        return (rng.standard_normal(shape) / np.sqrt(shape[-1])).astype(np.float32)

    tensors = {
        "t2m_moveencoder.main.0.weight": draw(12, features, 4), "t2m_moveencoder.main.0.bias": draw(12),
        "t2m_moveencoder.main.3.weight": draw(10, 12, 4), "t2m_moveencoder.main.3.bias": draw(10),
        "t2m_moveencoder.out_net.weight": draw(10, 10), "t2m_moveencoder.out_net.bias": draw(10),
        "t2m_textencoder.pos_emb.weight": draw(words, 15), "t2m_textencoder.pos_emb.bias": draw(words),
    }  # fmt: skip
    for name, width in (("motion", 10), ("text", words)):
        hidden, out = 16, 8
        shapes = {"input_emb.weight": (hidden, width), "input_emb.bias": (hidden,), "hidden": (2, 1, hidden),
                  "output_net.0.weight": (hidden, 2 * hidden), "output_net.0.bias": (hidden,),
                  "output_net.1.weight": (hidden,), "output_net.1.bias": (hidden,),
                  "output_net.3.weight": (out, hidden), "output_net.3.bias": (out,)}  # fmt: skip
        for side in ("", "_reverse"):
            shapes |= {f"gru.weight_{kind}_l0{side}": (3 * hidden, hidden) for kind in ("ih", "hh")}
            shapes |= {f"gru.bias_{kind}_l0{side}": (3 * hidden,) for kind in ("ih", "hh")}
        tensors |= {f"t2m_{name}encoder.{key}": draw(*shape) for key, shape in shapes.items()}
    return tensors


def write_glove(folder: Path) -> Path:
    """Write our_vab_data.npy and its pickled lists."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.Generator(np.random.PCG64(5))
    np.save(folder / "our_vab_data.npy", rng.standard_normal((len(WORDS), 300)).astype(np.float32))
    (folder / "our_vab_words.pkl").write_bytes(pickle.dumps(list(WORDS)))
    (folder / "our_vab_idx.pkl").write_bytes(pickle.dumps({word: row for row, word in enumerate(WORDS)}))
    return folder


def write_evaluator_stats(folder: Path, features: int = 263) -> Path:
    """Write the evaluators' own mean.npy and std.npy."""
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "mean.npy", np.zeros(features))
    np.save(folder / "std.npy", np.ones(features))
    return folder
