"""Read tensors of files that others wrote, as tensors alone, and put them into modules, every name accounted for."""

from __future__ import annotations

import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.serialization import get_unsafe_globals_in_checkpoint, safe_globals

from kinegraph.errors import InvalidInputError
from kinegraph.validation import short_repr

IGNORED_PARTS = ("text_encoder", "t2m_textencoder", "t2m_moveencoder", "t2m_motionencoder")
"""First parts of names that are left out: CLIP, which comes from its own folder, and the evaluators."""
WRAPPERS = ("module", "_orig_mod")
"""Parts that data parallelism and compilation put into names, before all of them or before those of one network."""
TRAINER = "model."
"""Prefix that trainers put before every name."""
LOAD_ERRORS = (pickle.UnpicklingError, RuntimeError, ValueError, EOFError, TypeError, AttributeError, KeyError)
"""What torch raises for files that it does not read."""
_SHOWN = 4
"""Names in a message."""

Tensors = Mapping[str, Tensor]
"""By name."""


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

    Classes that trainers leave in a checkpoint (settings, callbacks) are replaced by inert ones. What wrappers add to
    names (`WRAPPERS`, `TRAINER`) is removed.

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
        raise InvalidInputError(f"{path} holds no named tensors; keys are {list_names(map(str, content))}")
    tensors = _unwrapped(path, tensors)
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


def _unwrapped(path: Path, tensors: Tensors) -> Tensors:
    """Remove from names what wrappers of networks add to them.

    Raises:
        InvalidInputError: two names become one.
    """
    renamed: dict[str, Tensor] = {}
    for name, value in tensors.items():
        plain = ".".join(part for part in name.split(".") if part not in WRAPPERS)
        if plain in renamed:
            raise InvalidInputError(
                f"{path} holds {plain} twice, once as {name}: a network and its wrapped copy; save one of them alone"
            )
        renamed[plain] = value
    while all(name.startswith(TRAINER) for name in renamed):
        renamed = {name.removeprefix(TRAINER): value for name, value in renamed.items()}
    return renamed


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
            f"{path} is in half precision ({list_names(half)}); bring the float32 checkpoint: rounded weights move "
            "clips, and a bundle is made smaller by --precision int8"
        )
    for name, value in tensors.items():
        if value.is_floating_point() and not torch.isfinite(value).all():
            raise InvalidInputError(f"{path}: {name} holds NaN or infinity; the file is damaged, download it again")


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
                f"the checkpoint {problem} {list_names(names)}: it is another version of {model}, whose released "
                "network alone can be imported"
            )
    for prefix, module in modules.items():
        state = {name: tensors[f"{prefix}{name}"] for name in module.state_dict()}
        module.load_state_dict(state, assign=True)
        module.requires_grad_(False).eval()


def list_names(names: Iterable[str]) -> str:
    """List the first names, and tell how many more there are."""
    listed = sorted(names)
    more = f" and {len(listed) - _SHOWN} more" if len(listed) > _SHOWN else ""
    return ", ".join(listed[:_SHOWN]) + more
