"""Errors that kinegraph raises on purpose; catch `KinegraphError` to catch them all.

Every message names the wrong value, what is allowed, and what to do next.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kinegraph.unknown import Unknown


class KinegraphError(Exception):
    """Base of all errors raised on purpose."""


class InvalidInputError(KinegraphError, ValueError):
    """A text, graph or option is outside what the model accepts; but for `MissedConstraintError`, no model has run."""


class InvalidGraphError(InvalidInputError):
    """A semantic graph breaks the format, or an edit names a node or edge that does not exist."""


class MissedConstraintError(InvalidInputError):
    """A clip was made that missed a constraint by 5 cm or more, and the caller asked for `strict`."""


class UnknownWordsError(InvalidInputError):
    """A sentence has words that the bundle was never shown, and the caller asked for `strict`."""

    def __init__(self, message: str, unknown: tuple[Unknown, ...] = ()) -> None:
        super().__init__(message)
        self.unknown = unknown
        """Words and the known phrases nearest to them."""


class BundleError(KinegraphError):
    """The bundle cannot be used."""


class BundleFormatError(BundleError):
    """The manifest breaks the format: unknown key, wrong type or version, path outside the folder."""


class BundleIntegrityError(BundleError):
    """A file of the bundle is missing, extra, or differs from the manifest's size or SHA-256."""


class MissingExtraError(KinegraphError, ImportError):
    """An optional dependency is not installed; the message names the extra to install."""


class OutputError(KinegraphError, OSError):
    """The result cannot be written to the path that the caller chose."""


class ModelError(KinegraphError, RuntimeError):
    """A model, a tokenizer or a parser failed while it ran; the message names it and the reason."""


class NonFiniteError(KinegraphError, ArithmeticError):
    """A model produced NaN or infinity; the message names the stage."""


class Cancelled(KinegraphError):
    """The caller's `on_step` stopped the run."""


class TimedOut(Cancelled, TimeoutError):
    """The call took longer than its `timeout`."""
