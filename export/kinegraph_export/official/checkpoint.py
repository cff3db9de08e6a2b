"""Read the published checkpoints of GraphMotion and MLD: tensors only, and every key accounted for.

    read_tensors         file -> names and float32 tensors; nothing of the file is executed
    graphmotion_models   tensors -> three autoencoders, three denoisers, graph attention
    mld_models           tensors -> one autoencoder, one denoiser

Sizes are read off the tensors, so that models of any depth and width fit; the numbers of heads cannot be.
"""

from __future__ import annotations

import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.serialization import get_unsafe_globals_in_checkpoint, safe_globals

from kinegraph.bundle.contract import LEVELS
from kinegraph.errors import InvalidInputError
from kinegraph.validation import short_repr
from kinegraph_export.official.denoiser import OfficialDenoiser, OfficialDenoiserConfig
from kinegraph_export.official.graph_attention import ReleasedGraphAttention
from kinegraph_export.official.vae import OfficialVae, OfficialVaeConfig

IGNORED_PARTS = ("text_encoder", "t2m_textencoder", "t2m_moveencoder", "t2m_motionencoder")
"""First parts of names that are left out: CLIP, which comes from its own folder, and the evaluators."""
WRAPPERS = ("module.", "model.", "_orig_mod.")
"""Prefixes that data parallelism, trainers and compilation put before every name."""
VAE_HEADS, DENOISER_HEADS = 4, 16
"""Of the released GraphMotion; MLD has 4 throughout."""
LOAD_ERRORS = (pickle.UnpicklingError, RuntimeError, ValueError, EOFError, TypeError, AttributeError, KeyError)
"""What torch raises for files that it does not read."""
_SHOWN = 4
"""Names in a message."""

Tensors = Mapping[str, Tensor]


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


class _IgnoredDict:
    """Stand in for a class of a checkpoint: make an empty dictionary, which takes items and attributes."""

    def __new__(cls, *_: Any, **__: Any) -> Any:
        return OrderedDict()


class _IgnoredObject:
    """Stand in for a class of a checkpoint that is no dictionary: take any state, and do nothing."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __setstate__(self, _: Any) -> None:
        pass


def read_tensors(path: Path, parts: Sequence[str] = ()) -> dict[str, Tensor]:
    """Read the tensors of a checkpoint (.ckpt, .pt, .pth, .bin or .safetensors) without running any of its code.

    Classes that trainers leave in a checkpoint (settings, callbacks) are replaced by inert ones. Prefixes that all
    names share (`WRAPPERS`) are removed.

    Args:
        path: of the file.
        parts: first parts of the names that are wanted; none takes all but `IGNORED_PARTS`.

    Raises:
        InvalidInputError: no such file, no checkpoint, or tensors that are not finite float32; says what to do.
    """
    if not path.is_file():
        raise InvalidInputError(f"{path} is no file; name the checkpoint that you downloaded")
    content = _read_safetensors(path) if path.suffix == ".safetensors" else _read_pickled(path)
    tensors = _named_tensors(content.get("state_dict", content))
    if not tensors:
        raise InvalidInputError(f"{path} holds no named tensors; keys are {_listed(map(str, content))}")
    while prefix := next((w for w in WRAPPERS if all(name.startswith(w) for name in tensors)), ""):
        tensors = {name.removeprefix(prefix): value for name, value in tensors.items()}
    wanted = {
        name: value
        for name, value in tensors.items()
        if (name.split(".")[0] in parts if parts else name.split(".")[0] not in IGNORED_PARTS)
    }
    _check_numbers(path, wanted)
    return wanted


def _named_tensors(content: object) -> dict[str, Tensor]:
    """Pick the tensors of a mapping, and those of mappings in it, which evaluators are saved as."""
    if not isinstance(content, Mapping):
        return {}
    tensors = {str(name): value for name, value in content.items() if isinstance(value, Tensor)}
    for part, inner in content.items():
        if isinstance(inner, Mapping):
            tensors |= {f"{part}.{name}": value for name, value in inner.items() if isinstance(value, Tensor)}
    return tensors


def _read_safetensors(path: Path) -> dict[str, Any]:
    try:
        return dict(load_file(path))
    except (SafetensorError, OSError) as error:
        raise InvalidInputError(f"{path} is not a safetensors file: {error}; download it again") from error


def _read_pickled(path: Path) -> dict[str, Any]:
    if not zipfile.is_zipfile(path):
        raise InvalidInputError(
            f"{path} is not a checkpoint of torch 1.6 or later (a zip archive): it was cut short, is a web page saved "
            "under its name, or is older; download it again"
        )
    try:
        content = _load_inert(path, _IgnoredDict)
    except LOAD_ERRORS:
        try:
            content = _load_inert(path, _IgnoredObject)
        except LOAD_ERRORS as error:
            reason = str(error).partition("WeightsUnpickler error: ")[2].strip() or str(error)
            first_line = reason.split("\n")[0]
            raise InvalidInputError(
                f"{path} cannot be read as tensors alone ({first_line}); code in a checkpoint is never run, so save "
                "its state_dict by itself where you trust it: torch.save(checkpoint['state_dict'], ...)"
            ) from error
    if not isinstance(content, dict):
        raise InvalidInputError(f"{path} holds {short_repr(type(content).__name__)} instead of named tensors")
    return content


def _load_inert(path: Path, stand_in: type) -> Any:
    """Load a file with a stand-in for every class that torch does not know as harmless."""
    foreign = get_unsafe_globals_in_checkpoint(path)
    inert: list[Any] = [(type("Ignored", (stand_in,), {}), name) for name in foreign]
    with safe_globals(inert):
        return torch.load(path, map_location="cpu", weights_only=True, mmap=True)


def _check_numbers(path: Path, tensors: Tensors) -> None:
    """Refuse tensors that are not float32 or not finite."""
    half = [name for name, value in tensors.items() if value.dtype in (torch.float16, torch.bfloat16)]
    if half:
        raise InvalidInputError(
            f"{path} is in half precision ({_listed(half)}); bring the float32 checkpoint: rounded weights move "
            "clips, and a bundle is made smaller by --precision int8"
        )
    for name, value in tensors.items():
        if value.is_floating_point() and not torch.isfinite(value).all():
            raise InvalidInputError(f"{path}: {name} holds NaN or infinity; the file is damaged, download it again")


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
        raise InvalidInputError(f"this is no checkpoint of MLD: it has no denoiser; it has {_listed(_parts(tensors))}")
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
        f"this is no checkpoint of the released GraphMotion: it has {_listed(sorted(parts))} instead of vae_stage1 to "
        "3, denoiser_stage1 to 3 and gat; bring GraphMotion.ckpt"
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


def load_weights(modules: Mapping[str, nn.Module], tensors: Tensors, model: str) -> None:
    """Load tensors into modules, each under its prefix; every name must have its place, and every place its name.

    Raises:
        InvalidInputError: names are missing, unknown, or of another shape.
    """
    states = {prefix: module.state_dict() for prefix, module in modules.items()}
    expected = {f"{prefix}{name}": value for prefix, state in states.items() for name, value in state.items()}
    missing, unknown = sorted(expected.keys() - tensors.keys()), sorted(tensors.keys() - expected.keys())
    wrong = [
        f"{name} {tuple(tensors[name].shape)} instead of {tuple(value.shape)}"
        for name, value in expected.items()
        if name in tensors and tensors[name].shape != value.shape
    ]
    for problem, names in (("lacks", missing), ("has unknown", unknown), ("has other shapes:", wrong)):
        if names:
            raise InvalidInputError(
                f"the checkpoint {problem} {_listed(names)}: it is another version of {model}, whose released network "
                "alone can be imported"
            )
    for prefix, module in modules.items():
        state = {name: tensors[f"{prefix}{name}"] for name in module.state_dict()}
        module.load_state_dict(state, assign=True)
        module.requires_grad_(False).eval()


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


def _listed(names: Iterable[str]) -> str:
    """List the first names, and tell how many more there are."""
    listed = sorted(names)
    more = f" and {len(listed) - _SHOWN} more" if len(listed) > _SHOWN else ""
    return ", ".join(listed[:_SHOWN]) + more
