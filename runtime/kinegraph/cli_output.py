"""What the command line shows: the progress line, JSON, and the tables of `info` and `verify`."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self, TextIO

if TYPE_CHECKING:
    from kinegraph.bundle import Bundle
    from kinegraph.diffusion.sampler import StepInfo
    from kinegraph.verify import VerifyReport

_BAR: Final = 24
_CLEAR_LINE: Final = "\r\x1b[K"


class Progress:
    """One line on stderr that is rewritten at every step and gone at the end."""

    def __init__(self, stream: TextIO | None) -> None:
        """Show on `stream`; None shows nothing."""
        self._stream = stream

    @classmethod
    def on_stderr(cls, *, quiet: bool, forced: bool) -> Self:
        """A line for people at a terminal; a log file gets none unless asked for."""
        wanted = forced or sys.stderr.isatty()
        return cls(sys.stderr if wanted and not quiet else None)

    def show(self, info: StepInfo) -> None:
        """Callback of `generate`; never asks to stop."""
        if self._stream is not None:
            bar = ("#" * (_BAR * info.done // info.total)).ljust(_BAR, ".")
            self._stream.write(f"{_CLEAR_LINE}[{bar}] {info.level} {info.step}/{info.steps}")
            self._stream.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._stream is not None:
            self._stream.write(_CLEAR_LINE)
            self._stream.flush()


def as_json(value: object, *, pretty: bool = False) -> str:
    """JSON for stdout; escapes what a terminal that is not UTF-8 could not take."""
    utf8 = (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"
    return json.dumps(value, ensure_ascii=not utf8, indent=2 if pretty else None)


def one_line(error: BaseException) -> str:
    """The message of an error on one line, whatever it quotes."""
    return " ".join(str(error).split())


def info_record(bundle: Bundle) -> dict[str, Any]:
    """What `info` tells, as plain values."""
    from kinegraph.strict_json import plain

    manifest = plain(bundle.manifest)
    features = manifest["features"]
    return {
        "name": manifest["name"],
        "version": manifest["version"],
        "path": str(bundle.path),
        "precision": manifest["precision"],
        "licence": manifest["licence"],
        "provenance": manifest["provenance"],
        "scope": manifest["scope"],
        "seconds": list(bundle.manifest.seconds_limits),
        "fps": manifest["fps"],
        "features": {"layout": features["layout"], "heading": features["heading"]},
        "levels": manifest["levels"],
        "defaults": manifest["defaults"],
        "bytes": {name: entry["bytes"] for name, entry in manifest["files"].items()},
        "training": manifest["training"],
        "quality": manifest["quality"],
        "parity": manifest["parity"],
    }


def info_text(record: Mapping[str, Any]) -> str:
    """The table of `kinegraph info`."""
    sizes = record["bytes"]
    shortest, longest = record["seconds"]
    defaults = record["defaults"]
    lines = [
        f"{record['name']} {record['version']} ({record['precision']}, {_megabytes(sum(sizes.values()))})",
        record["path"],
        f"clips of {shortest:g} to {longest:g} seconds at {record['fps']:g} frames per second, "
        f"default {defaults['seconds']:g}; features {record['features']['layout']}",
    ]
    for name, level in record["levels"].items():
        lines.append(
            f"  {name:<9} {level['tokens']} tokens, {level['layers']} layers of width {level['width']}, "
            f"{defaults['steps'][name]} steps, guidance {defaults['guidance'][name]:g}"
        )
    lines += _section("what it can do, and what it cannot", record["scope"])
    lines += _section("licences", record["licence"])
    lines += _section("provenance", record["provenance"])
    lines += _section("training", record["training"])
    lines += _section("quality", record["quality"])
    lines += _section("parity (largest difference; int8: relative; mm: mean of joints)", record["parity"])
    lines += _section("files", {name: _megabytes(size) for name, size in sizes.items()})
    return "\n".join(lines)


def verify_text(report: VerifyReport) -> str:
    """The table of `kinegraph verify`; there is one only if all is well."""
    lines = [f"{report.name} {report.version}", str(report.path)]
    for name, size in report.files.items():
        operators = report.operators.get(name)
        graph = f", {operators} operators as listed, loads, contract kept" if operators else ""
        lines.append(f"  ok  {name}: {size} bytes, SHA-256 agrees{graph}")
    lines.append(f"ok: {len(report.files)} files, {len(report.sessions)} graphs")
    return "\n".join(lines)


def _section(title: str, values: Mapping[str, object]) -> list[str]:
    if not values:
        return []
    width = max(len(key) for key in values)
    return ["", f"{title}:", *(f"  {key:<{width}}  {_value(value)}" for key, value in values.items())]


def _value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB"
