"""Made checkpoints and folders in the published layouts, with random weights: GraphMotion, MLD, CLIP, statistics."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from kinegraph.bundle.contract import LEVELS
from kinegraph_export.clip_text_encoder import BEGIN, END, ClipConfig, ClipText
from kinegraph_export.official.denoiser import OfficialDenoiser, OfficialDenoiserConfig
from kinegraph_export.official.graph_attention import ReleasedGraphAttention
from kinegraph_export.official.vae import OfficialVae, OfficialVaeConfig

TEXT_WIDTH = 40
"""That of ../shared/fixtures/official, so that its weights fit the made CLIP."""
HEADS = 4
LATENT, WIDTH, FEED_FORWARD = 16, 24, 32
MERGES = ("t h", "th e</w>", "w a", "wa l", "wal k", "walk s</w>", "p e", "r s", "pe rs", "o n</w>", "pers on</w>")


def randomise(module: nn.Module, seed: int) -> nn.Module:
    """Give every parameter random numbers of a size that keeps signals alive."""
    generator = torch.Generator().manual_seed(seed)
    for name, value in module.named_parameters():
        scale = 0.1 if value.ndim == 1 else (2.0 / sum(value.shape[-2:])) ** 0.5
        noise = torch.randn(value.shape, generator=generator) * scale
        value.data = noise + (1.0 if "norm" in name and name.endswith("weight") else 0.0)
    return module


def graphmotion_tensors(features: int = 263) -> dict[str, Tensor]:
    """A small GraphMotion with random weights under its published names; 251 features make it one of KIT-ML."""
    attention = ReleasedGraphAttention(TEXT_WIDTH)
    modules: dict[str, nn.Module] = {"gat.": attention}
    for stage, tokens in enumerate((2, 4, 8), start=1):
        vae = OfficialVaeConfig(features, tokens, LATENT, 3, HEADS, FEED_FORWARD, 263)
        denoiser = OfficialDenoiserConfig(tokens, LATENT, WIDTH, 3, HEADS, FEED_FORWARD, TEXT_WIDTH, True)
        modules |= {f"vae_stage{stage}.": OfficialVae(vae), f"denoiser_stage{stage}.": OfficialDenoiser(denoiser)}
    return _tensors(modules)


def mld_tensors(features: int = 263) -> dict[str, Tensor]:
    """A small MLD with random weights under its published names; it embeds the 251 features of KIT-ML as they are."""
    vae = OfficialVaeConfig(features, 1, LATENT, 3, HEADS, FEED_FORWARD, features)
    denoiser = OfficialDenoiserConfig(1, LATENT, LATENT, 3, HEADS, FEED_FORWARD, TEXT_WIDTH, False)
    return _tensors({"vae.": OfficialVae(vae), "denoiser.": OfficialDenoiser(denoiser)})


def _tensors(modules: Mapping[str, nn.Module]) -> dict[str, Tensor]:
    return {
        f"{prefix}{name}": value.detach().clone()
        for seed, (prefix, module) in enumerate(modules.items())
        for name, value in randomise(module, seed).state_dict().items()
    }


def write_lightning(path: Path, tensors: Mapping[str, Tensor], **entries: Any) -> Path:
    """Write a checkpoint as the trainer of the released code does, the evaluators' weights included."""
    evaluators = {"t2m_textencoder.pos_emb.weight": torch.zeros(3, 2)}
    torch.save({"epoch": 2999, "state_dict": {**tensors, **evaluators}, **entries}, path)
    return path


def byte_names() -> list[str]:
    """The 256 bytes as byte-pair vocabularies write them: printable ones as they are, the rest from U+0100 on."""
    printable = [*range(33, 127), *range(161, 173), *range(174, 256)]
    others = [byte for byte in range(256) if byte not in printable]
    return [chr(byte) for byte in printable] + [chr(256 + index) for index in range(len(others))]


def write_clip(
    folder: Path, *, width: int = TEXT_WIDTH, projection: int | None = None, seed: int = 0, **settings: Any
) -> Path:
    """Write a text tower of random weights in the layout of openai/clip-vit-large-patch14."""
    folder.mkdir(parents=True)
    names = byte_names()
    merged = ["".join(pair.split()) for pair in MERGES]
    vocabulary = [*names, *(f"{name}</w>" for name in names), *merged, BEGIN, END]
    (folder / "vocab.json").write_text(json.dumps({token: index for index, token in enumerate(vocabulary)}))
    (folder / "merges.txt").write_text("\n".join(["#version: 0.2", *MERGES]) + "\n")
    config = ClipConfig(len(vocabulary), 77, width, 2, HEADS, 2 * width, projection or width, 1e-5, "quick_gelu")
    text = {"num_attention_heads": HEADS, "hidden_act": "quick_gelu", "eos_token_id": 2, **settings}
    (folder / "config.json").write_text(json.dumps({"model_type": "clip", "text_config": text}))
    tensors = dict(randomise(ClipText(config), seed).state_dict())
    tensors["vision_model.embeddings.class_embedding"] = torch.zeros(4)
    tensors["logit_scale"] = torch.tensor(4.6)
    save_file({name: value.contiguous() for name, value in tensors.items()}, folder / "model.safetensors")
    return folder


def write_statistics(folder: Path, features: int = 263) -> Path:
    """Write Mean.npy and Std.npy like those of a data set."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.Generator(np.random.PCG64(3))
    mean = rng.normal(0.0, 0.1, features)
    mean[3] = 0.9  # height of the pelvis
    np.save(folder / "Mean.npy", mean.astype(np.float32))
    np.save(folder / "Std.npy", rng.uniform(0.01, 0.05, features).astype(np.float32))
    return folder


def levels_by_stage() -> dict[int, str]:
    """Number of a stage in the checkpoint -> level."""
    return dict(enumerate(LEVELS, start=1))
