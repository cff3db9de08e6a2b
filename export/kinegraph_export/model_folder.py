"""Read what folders in Hugging Face's layout tell of a model: where its weights are, and its settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from kinegraph.errors import InvalidInputError

WEIGHT_FILES: Final = ("model.safetensors", "pytorch_model.bin")
"""In the order in which they are looked for."""
SETTINGS: Final = "config.json"


def find_weights(folder: Path, model: str) -> Path:
    """Find the file of the weights.

    Args:
        folder: of Hugging Face's files.
        model: name of the model that belongs there, for messages.

    Raises:
        InvalidInputError: no such folder, or no weights in it.
    """
    if not folder.is_dir():
        raise InvalidInputError(f"{folder} is no folder; name that of {model}, with {SETTINGS} and {WEIGHT_FILES[0]}")
    weights = next((folder / name for name in WEIGHT_FILES if (folder / name).is_file()), None)
    if weights is None:
        raise InvalidInputError(f"{folder} has none of {', '.join(WEIGHT_FILES)}; download the model's weights into it")
    return weights


def read_settings(folder: Path) -> dict[str, Any]:
    """Read config.json.

    Raises:
        InvalidInputError: it is missing or holds something else.
    """
    path = folder / SETTINGS
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"{path} cannot be read: {error}; it comes with the model's weights") from error
    if not isinstance(content, dict):
        raise InvalidInputError(f"{path} holds no settings of a model; it comes with the model's weights")
    return content
