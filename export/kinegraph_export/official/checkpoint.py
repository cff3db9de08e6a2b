"""Build the networks of the published checkpoints of GraphMotion and MLD.

    read_tensors         file -> names and float32 tensors (`tensor_files`)
    graphmotion_models   tensors -> three autoencoders, three denoisers, graph attention
    mld_models           tensors -> one autoencoder, one denoiser

Sizes are read off the tensors, so that models of any depth and width fit; the numbers of heads cannot be.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from torch import nn

from kinegraph.bundle.contract import LEVELS
from kinegraph.errors import InvalidInputError
from kinegraph_export.official.denoiser import OfficialDenoiser, OfficialDenoiserConfig
from kinegraph_export.official.graph_attention import ReleasedGraphAttention
from kinegraph_export.official.vae import OfficialVae, OfficialVaeConfig
from kinegraph_export.tensor_files import Tensors, list_names, load_weights

VAE_HEADS, DENOISER_HEADS = 4, 16
"""Of the released GraphMotion; MLD has 4 throughout."""


@dataclass(frozen=True)
class GraphMotionModels:
    """All networks of a released GraphMotion."""

    vaes: Mapping[str, OfficialVae]
    """By level."""
    denoisers: Mapping[str, OfficialDenoiser]
    """By level."""
    graph_attention: ReleasedGraphAttention


@dataclass(frozen=True)
class MldModels:
    """Both networks of a released MLD."""

    vae: OfficialVae
    denoiser: OfficialDenoiser


def graphmotion_models(
    tensors: Tensors, *, vae_heads: int = VAE_HEADS, denoiser_heads: int = DENOISER_HEADS
) -> GraphMotionModels:
    """Build the networks of a released GraphMotion.

    Args:
        tensors: of `read_tensors`.
        vae_heads: attention heads of the autoencoders.
        denoiser_heads: attention heads of the denoisers.

    Raises:
        InvalidInputError: another model, or names or shapes that do not fit; lists what is missing and unknown.
    """
    _check_is_graphmotion(tensors)
    text_width = _shape(tensors, "gat.W")[0]
    vaes = {level: build_vae(tensors, f"vae_stage{stage}.", vae_heads) for stage, level in enumerate(LEVELS, start=1)}
    denoisers = {
        level: build_denoiser(tensors, f"denoiser_stage{stage}.", vaes[level].config.tokens, denoiser_heads)
        for stage, level in enumerate(LEVELS, start=1)
    }
    attention = ReleasedGraphAttention(text_width)
    modules: dict[str, nn.Module] = {"gat.": attention}
    for stage, level in enumerate(LEVELS, start=1):
        modules |= {f"vae_stage{stage}.": vaes[level], f"denoiser_stage{stage}.": denoisers[level]}
    load_weights(modules, tensors, "GraphMotion")
    return GraphMotionModels(vaes, denoisers, attention)


def mld_models(tensors: Tensors, *, heads: int = VAE_HEADS) -> MldModels:
    """Build the networks of a released MLD; see `graphmotion_models`."""
    if any(name.startswith("vae_stage") for name in tensors):
        raise InvalidInputError("this is a checkpoint of GraphMotion: use kinegraph_export.import_graphmotion")
    if not any(name.startswith("denoiser.") for name in tensors):
        parts = list_names(_parts(tensors))
        raise InvalidInputError(f"this is no checkpoint of MLD: it has no denoiser; it has {parts}")
    vae = build_vae(tensors, "vae.", heads)
    denoiser = build_denoiser(tensors, "denoiser.", vae.config.tokens, heads)
    load_weights({"vae.": vae, "denoiser.": denoiser}, tensors, "MLD")
    return MldModels(vae, denoiser)


def _check_is_graphmotion(tensors: Tensors) -> None:
    parts = _parts(tensors)
    if "vae_stage1" in parts and "denoiser_stage1" in parts and "gat" in parts:
        return
    if {"vae", "denoiser"} <= parts and "gat" not in parts:
        raise InvalidInputError(
            "this checkpoint has one autoencoder and one denoiser: it is MLD's (use kinegraph_export.import_mld), or "
            "that of one autoencoder of GraphMotion, which cannot generate (bring GraphMotion.ckpt, of all stages)"
        )
    raise InvalidInputError(
        f"this is no checkpoint of the released GraphMotion: it has {list_names(parts)} instead of vae_stage1 "
        "to 3, denoiser_stage1 to 3 and gat; bring GraphMotion.ckpt"
    )


def build_vae(tensors: Tensors, prefix: str, heads: int) -> OfficialVae:
    """Build an autoencoder of the sizes of its tensors, without their values.

    Args:
        tensors: of a checkpoint.
        prefix: of its names.
        heads: attention heads.

    Raises:
        InvalidInputError: a tensor that tells a size is missing, or the heads do not divide the width.
    """
    queries, width = _shape(tensors, f"{prefix}global_motion_token")
    embedded = _shape(tensors, f"{prefix}skel_embedding.weight")[1]
    adapter = f"{prefix}input_proj.weight"
    feed_forward = _shape(tensors, f"{prefix}encoder.middle_block.linear1.weight")[0]
    layers = count_layers(tensors, f"{prefix}encoder.")
    _check_heads(prefix, width, heads)
    features = _shape(tensors, adapter)[1] if adapter in tensors else embedded
    return OfficialVae(OfficialVaeConfig(features, queries // 2, width, layers, heads, feed_forward, embedded))


def build_denoiser(tensors: Tensors, prefix: str, tokens: int, heads: int) -> OfficialDenoiser:
    """Build a denoiser of the sizes of its tensors; arguments as for `build_vae`, and its latent tokens."""
    width, text_width = _shape(tensors, f"{prefix}emb_proj.1.weight")
    lift = f"{prefix}large_encoder_proj.0.weight"
    is_lifted = lift in tensors
    latent_width = _shape(tensors, lift)[1] if is_lifted else width
    feed_forward = _shape(tensors, f"{prefix}encoder.middle_block.linear1.weight")[0]
    layers = count_layers(tensors, f"{prefix}encoder.")
    _check_heads(prefix, width, heads)
    shape = (tokens, latent_width, width, layers, heads, feed_forward, text_width)
    return OfficialDenoiser(OfficialDenoiserConfig(*shape, is_lifted))


def count_layers(tensors: Tensors, prefix: str) -> int:
    """Count the layers of a stack with skips from the names of its joins."""
    start = f"{prefix}linear_blocks."
    return 2 * len({name.removeprefix(start).split(".")[0] for name in tensors if name.startswith(start)}) + 1


def _check_heads(prefix: str, width: int, heads: int) -> None:
    if heads < 1 or width % heads:
        raise InvalidInputError(f"{prefix[:-1]} is {width} wide, which {heads} heads do not divide")


def _shape(tensors: Tensors, name: str) -> tuple[int, int]:
    if name not in tensors or tensors[name].ndim != 2:
        raise InvalidInputError(f"the checkpoint lacks {name}, a matrix; it is another version, or was cut short")
    rows, columns = tensors[name].shape
    return rows, columns


def _parts(tensors: Iterable[str]) -> set[str]:
    return {name.split(".")[0] for name in tensors}
