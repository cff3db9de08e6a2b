"""What a character is read from: its file, the files that it refers to, and the caller's map of joints.

Files of strangers: sizes are bounded, and nothing outside the character's own folder is opened.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
from pathlib import Path
from typing import Final
from urllib.parse import unquote

from kinegraph.errors import InvalidInputError
from kinegraph.formats.gltf import Document

MAX_BYTES: Final = 1 << 28
"""Size of a character, and of a file that it refers to."""
_MAX_MAP_BYTES: Final = 1 << 16
_COMPRESSED: Final = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")


def read_names(path: str | os.PathLike[str]) -> dict[str, str]:
    """Read a map of joints: a JSON object {"left_hip": "name of a node", ...}.

    Raises:
        InvalidInputError: no such file, or no such object.
    """
    data = read_bytes(Path(path), _MAX_MAP_BYTES, (".json",))
    try:
        names = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"{str(path)!r} is no JSON ({str(error)[:200]})") from error
    if not isinstance(names, dict) or not all(isinstance(name, str) for name in names.values()):
        raise InvalidInputError(f'{str(path)!r} must hold an object like {{"left_hip": "name of a joint"}}')
    return names


def read_bytes(path: Path, most: int, suffixes: tuple[str, ...]) -> bytes:
    name = repr(str(path))
    if path.suffix.lower() not in suffixes:
        raise InvalidInputError(f"{name} has the wrong suffix; it must be {' or '.join(suffixes)}")
    try:
        if not path.is_file():
            raise InvalidInputError(f"there is no file {name}")
        if path.stat().st_size > most:
            raise InvalidInputError(f"{name} is larger than {most >> 20} MiB; make its textures smaller")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, InvalidInputError):
            raise
        raise InvalidInputError(f"{name} cannot be read ({error}); check the name and its permissions") from error


def refuse_compressed(document: Document) -> None:
    used = {*document.get("extensionsUsed", ()), *document.get("extensionsRequired", ())}
    if found := [extension for extension in _COMPRESSED if extension in used]:
        raise InvalidInputError(
            f"it is compressed ({', '.join(found)}); decompress it first: "
            "npx @gltf-transform/cli copy hero.glb plain.glb"
        )


def embed(document: Document, binary: bytes, folder: Path | None) -> tuple[Document, bytes]:
    """Bring buffers and images that are files of their own into the binary chunk.

    Raises:
        InvalidInputError: a file is outside the folder, missing, or too large; or there is no folder.
    """
    buffers = document.get("buffers", [])
    images = document.get("images", [])
    if not any("uri" in entry for entry in (*buffers, *images)) and len(buffers) <= 1:
        length = buffers[0]["byteLength"] if buffers else 0
        if not isinstance(length, int) or not 0 <= length <= len(binary):
            raise InvalidInputError("its binary chunk is shorter than it says")
        return document, binary[:length]
    data, starts = bytearray(), []
    for index, entry in enumerate(buffers):
        part = _fetch(entry["uri"], folder) if "uri" in entry else binary if index == 0 else b""
        if not isinstance(entry["byteLength"], int) or not 0 <= entry["byteLength"] <= len(part):
            raise InvalidInputError(f"buffer {index} is shorter than it says")
        data += b"\0" * (-len(data) % 4)
        starts.append(len(data))
        data += part[: entry["byteLength"]]
    views = [
        {**view, "buffer": 0, "byteOffset": starts[view["buffer"]] + view.get("byteOffset", 0)}
        for view in document.get("bufferViews", [])
    ]
    embedded = []
    for image in images:
        if "uri" in image:
            part = _fetch(image["uri"], folder)
            data += b"\0" * (-len(data) % 4)
            views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(part)})
            data += part
            kind = image.get("mimeType") or _media_type(part)
            image = {key: value for key, value in image.items() if key != "uri"}
            image |= {"bufferView": len(views) - 1, "mimeType": kind}
        embedded.append(image)
    document = {**document, "buffers": [{"byteLength": len(data)}], "bufferViews": views}
    return (document | {"images": embedded} if images else document), bytes(data)


def _media_type(picture: bytes) -> str:
    """Tell the media type of a picture by its first bytes."""
    if picture[:4] == b"RIFF" and picture[8:12] == b"WEBP":
        return "image/webp"
    if picture[1:7] == b"KTX 20":
        return "image/ktx2"
    return "image/png" if picture.startswith(b"\x89PNG") else "image/jpeg"


def _fetch(uri: object, folder: Path | None) -> bytes:
    """Read a data URI, or a file in the folder or below."""
    if not isinstance(uri, str):
        raise InvalidInputError("it refers to a file by something that is no text")
    if uri.startswith("data:"):
        try:
            return base64.b64decode(uri.partition(",")[2], validate=True)
        except binascii.Error as error:
            raise InvalidInputError("it has a data URI that is damaged") from error
    if folder is None:
        raise InvalidInputError(f"it refers to the file {uri[:80]!r}; pack it all as one .glb")
    root = folder.resolve()
    target = root.joinpath(unquote(uri))
    if ":" in uri or "\\" in uri or "\0" in unquote(uri) or not target.resolve().is_relative_to(root):
        raise InvalidInputError(f"it refers to {uri[:80]!r}, which is not in its folder; pack the file as one .glb")
    return read_bytes(target, MAX_BYTES, (target.suffix.lower(),))
