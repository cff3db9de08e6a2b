"""Make the toy bundle: synthetic motion, all networks of the preset `toy.toml`, in float32.

    python tests/toy_bundle/make.py --work WORK_FOLDER --out tests/toy_bundle/bundle

Takes about ten minutes on one core and needs the extras `train`, `export` and `text`. A stopped run goes on where it
was.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from kinegraph.bundle.contract import LEVELS, PADDING_BIAS
from kinegraph.bundle.manifest import Licence, Manifest, decode_manifest, encode_manifest
from kinegraph.bundle.reader import text_files_folder
from kinegraph.motion.features import HEIGHT
from kinegraph_export.add_frames import add_frames
from kinegraph_export.export_bundle import BundleCard, export_bundle
from kinegraph_export.onnx_export import round_weights, serialise, store_float16, to_onnx
from kinegraph_training import train_denoisers, train_frames, train_vae
from kinegraph_training.data.folder import PreparedClip, write_data
from kinegraph_training.losses import kl_divergence, masked_mean
from kinegraph_training.models.transformer import EncoderLayer
from support.motions import stand, walk

HERE = Path(__file__).parent
PRESET = HERE / "toy.toml"
FPS = 20

CARD = BundleCard(
    name="toy",
    version="1",
    licence=Licence("Apache-2.0", "Apache-2.0", "none: synthetic motion", "Apache-2.0: random weights", "none"),
    training_data="stick figures of tests/support/motions.py",
    scope={"actions": "walk, run, wave, bow, stand", "cannot": "anything else"},
    training={"preset": "tests/toy_bundle/toy.toml"},
    steps={"motion": 4, "action": 4, "specific": 5},
    guidance={"motion": 1.5, "action": 1.5, "specific": 2.0},
    guidance_base="empty",
    seconds=2.0,
    quality={},
)

WORDS = (HERE / "words.txt").read_text(encoding="utf-8").split()
"""Captions of the tests in whole words; other words are spelled letter by letter."""

SPECIAL = ("[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]")
CHARACTERS = "abcdefghijklmnopqrstuvwxyz0123456789.,;:!?'\"-()/&+"


def tokenizer_json() -> bytes:
    """Build a WordPiece tokenizer with the normalisation of BERT and a vocabulary of a few hundred pieces."""
    from tokenizers import Tokenizer
    from tokenizers.models import WordPiece
    from tokenizers.normalizers import BertNormalizer
    from tokenizers.pre_tokenizers import BertPreTokenizer
    from tokenizers.processors import TemplateProcessing

    pieces = [*SPECIAL, *WORDS, *CHARACTERS, *(f"##{character}" for character in CHARACTERS)]
    vocabulary = {piece: number for number, piece in enumerate(dict.fromkeys(pieces))}
    tokenizer = Tokenizer(WordPiece(vocabulary, unk_token="[UNK]"))
    tokenizer.add_special_tokens(list(SPECIAL))
    tokenizer.normalizer = BertNormalizer(lowercase=True)
    tokenizer.pre_tokenizer = BertPreTokenizer()
    ends = [(piece, vocabulary[piece]) for piece in ("[CLS]", "[SEP]")]
    tokenizer.post_processor = TemplateProcessing(single="[CLS] $A [SEP]", special_tokens=ends)
    return tokenizer.to_str().encode()


class TextEncoder(nn.Module):
    """A transformer of one layer with random weights: enough to tell the words of a caption apart."""

    def __init__(self, pieces: int, width: int, positions: int = 512) -> None:
        super().__init__()
        self.words = nn.Embedding(pieces, width)
        self.positions = nn.Embedding(positions, width)
        self.layer = EncoderLayer(width, 4, 2 * width, dropout=0.0)
        self.norm = nn.LayerNorm(width)
        nn.init.normal_(self.positions.weight, std=0.1)

    def forward(self, input_ids: Tensor, attention_mask: Tensor) -> tuple[Tensor, Tensor]:
        """(b, t), (b, t) -> hidden (b, t, d), pooled (b, d)."""
        index = torch.cumsum(torch.ones_like(input_ids), dim=1) - 1
        mask = attention_mask.to(torch.float32)
        hidden = self.words(input_ids) + self.positions(index)
        hidden = self.norm(self.layer(hidden, ((1.0 - mask) * PADDING_BIAS)[:, None, None, :]))
        pooled = (hidden * mask[..., None]).sum(dim=1) / mask.sum(dim=1, keepdim=True).clamp(min=1.0)
        return hidden, pooled


def write_assets(folder: Path, width: int) -> None:
    """Write the toy's tokenizer and text encoder, and the default bundle's parser to train with."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "tokenizer.json").write_bytes(tokenizer_json())
    pieces = len(json.loads(tokenizer_json())["model"]["vocab"])
    torch.manual_seed(1)
    encoder = TextEncoder(pieces, width)
    round_weights(encoder)
    sample = (torch.tensor([[2, 5, 6, 3], [2, 7, 3, 0]]), torch.tensor([[1, 1, 1, 1], [1, 1, 1, 0]]))
    free = {0: torch.export.Dim.DYNAMIC, 1: torch.export.Dim.DYNAMIC}
    names = (["input_ids", "attention_mask"], ["hidden", "pooled"])
    model = store_float16(to_onnx(encoder, sample, *names, (free, free)))
    (folder / "text_encoder.onnx").write_bytes(serialise(model))
    for name in ("parser.bin", "arguments.npz"):
        shutil.copyfile(text_files_folder() / name, folder / name)


def then(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """One clip after another; both begin and end in the same pose on the same spot."""
    return np.concatenate([first, second[1:]])


def clips(rng: np.random.Generator, count: int = 12) -> Iterator[tuple[str, np.ndarray]]:
    """Draw `count` captioned clips of each kind; training mirrors them, so one side is enough."""
    speeds = {"": 0.05, " slowly": 0.025, " quickly": 0.08}

    def walking(pace: str, turning: float, frames: int) -> np.ndarray:
        speed = speeds[pace] * rng.uniform(0.9, 1.1)
        return walk(frames, turning=turning, speed=speed, cadence=0.2 + 3.0 * speed, swing=0.3 + 4.0 * speed)

    def running(turning: float, frames: int) -> np.ndarray:
        return walk(frames, turning=turning, speed=0.14 * rng.uniform(0.9, 1.1), cadence=0.7, swing=0.8)

    kinds: list[Callable[[str], tuple[str, np.ndarray]]] = [
        lambda who: (f"{who} walks forward", walking("", 0.0, int(rng.integers(60, 90)))),
        lambda who: (f"{who} walks slowly", walking(" slowly", 0.0, int(rng.integers(70, 100)))),
        lambda who: (f"{who} walks quickly forward", walking(" quickly", 0.0, int(rng.integers(50, 80)))),
        lambda who: (f"{who} walks to the left", walking("", rng.uniform(0.015, 0.025), int(rng.integers(60, 90)))),
        lambda who: (f"{who} walks and turns left", walking("", rng.uniform(0.03, 0.04), int(rng.integers(60, 90)))),
        lambda who: (f"{who} walks slowly to the left", walking(" slowly", 0.02, int(rng.integers(70, 100)))),
        lambda who: (f"{who} runs forward", running(0.0, int(rng.integers(40, 60)))),
        lambda who: (f"{who} runs", running(0.0, int(rng.integers(40, 60)))),
        lambda who: (f"{who} runs to the left", running(rng.uniform(0.02, 0.03), int(rng.integers(40, 60)))),
        lambda who: (f"{who} stands still", stand(int(rng.integers(30, 50)))),
        lambda who: (f"{who} bows", stand(int(rng.integers(30, 50)), bow=rng.uniform(0.8, 1.2))),
        lambda who: (f"{who} waves the right hand", stand(int(rng.integers(40, 60)), wave=rng.uniform(1.9, 2.3))),
        lambda who: (f"{who} raises the right hand", stand(int(rng.integers(30, 50)), wave=2.2, rate=0.0)),
        lambda who: (
            f"{who} waves the right hand, then bows",
            then(stand(int(rng.integers(40, 50)), wave=2.1), stand(int(rng.integers(30, 40)), bow=1.0)),
        ),
    ]
    standing = kinds[9:]  # twice as often: their motion is smaller
    people = ("a person", "someone", "the man", "a woman")
    for number in range(count):
        for kind in kinds + standing:
            yield kind(people[number % len(people)])


def write_clips(folder: Path) -> None:
    """Write the synthetic clips as a data folder; every twelfth is for validation."""
    prepared = [
        PreparedClip(f"clip{number}", joints, (caption,), "synthetic", "val" if number % 12 == 5 else "train")
        for number, (caption, joints) in enumerate(clips(np.random.default_rng(0)))
    ]
    write_data(folder, prepared, FPS)


class SquaredErrorVae(train_vae.VaeModule):
    """Autoencoder that learns squared errors of the features alone.

    The absolute errors of `VaeModule` are least for the median of motions that are not told apart yet. Among mirrored
    clips of which a quarter raise an arm, that is an arm which hangs, and so short a run stays there.
    """

    ROOT_WEIGHT = 20.0

    def training_step(self, batch: tuple[Tensor, Tensor], index: int) -> Tensor:
        features, mask = batch
        mean, log_variance = self.vae.encode(features, mask)
        latent = mean + torch.randn_like(mean) * torch.exp(0.5 * log_variance)
        error = (self.vae.decode(latent, mask) - features).square()
        error[..., : HEIGHT.stop] *= self.ROOT_WEIGHT
        loss = masked_mean(error, mask) + self.weights.kl * kl_divergence(mean, log_variance)
        self.log("train/loss", loss, batch_size=len(mask))
        return loss


def train(work: Path) -> None:
    """Run all stages of training; a stage that is done is passed over."""
    common = ["--data", str(work / "data"), "--run", str(work / "run"), "--preset", str(PRESET), "--threads", "1"]
    lightning = ["--enable_progress_bar", "0", "--accelerator", "cpu", "--precision", "32-true"]
    train_vae.VaeModule = SquaredErrorVae  # type: ignore[misc]
    for level in LEVELS:
        train_vae.main(["--level", level, *common, *lightning])
    train_denoisers.main(["--assets", str(work / "assets"), *common, *lightning])
    train_frames.main(["--assets", str(work / "assets"), *common, *lightning])


def keep_graphs(bundle: Path) -> Manifest:
    """Take parser and vocabulary out of an exported bundle, say where its text encoder is from, and seal it anew."""
    manifest = decode_manifest((bundle / "manifest.json").read_bytes())
    for name in ("parser.bin", "arguments.npz", "vocabulary.npz"):
        (bundle / name).unlink()
    provenance = {**manifest.provenance, "text_encoder": "random weights", "parser": "none", "arguments": "none"}
    files = {name: entry for name, entry in manifest.files.items() if (bundle / name).is_file()}
    manifest = dataclasses.replace(manifest, provenance=provenance, files=files)
    (bundle / "manifest.json").write_bytes(encode_manifest(manifest))
    return manifest


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--work", type=Path, required=True, help="folder for data and checkpoints")
    parser.add_argument("--out", type=Path, default=HERE / "bundle")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    write_assets(arguments.work / "assets", width=48)
    write_clips(arguments.work / "data")
    train(arguments.work)
    export_bundle(arguments.work / "run", arguments.work / "assets", CARD, arguments.out, "fp32")
    add_frames(arguments.out, arguments.work / "run", steps=5, guidance=2.0)
    manifest = keep_graphs(arguments.out)
    size = sum(entry.bytes for entry in manifest.files.values())
    print(f"{size / 1e6:.2f} MB in {arguments.out}, pipeline {manifest.parity['pipeline_mm']:.3f} mm from torch")


if __name__ == "__main__":
    main()
