"""The twelve edge types of the semantic graph (GraphMotion, section B.1) and their stable numbers."""

from __future__ import annotations

from typing import Final

MOTION_ACTION: Final = "ARGM-MA"
OTHERS: Final = "OTHERS"

ROLES: Final[tuple[str, ...]] = (
    "ARG0",
    "ARG1",
    "ARG2",
    "ARG3",
    "ARG4",
    "ARGM-LOC",
    "ARGM-MNR",
    "ARGM-TMP",
    "ARGM-DIR",
    "ARGM-ADV",
    MOTION_ACTION,
    OTHERS,
)
"""Position in this tuple is the relation number fed to the graph encoder; trained weights depend on it."""

ARGUMENT_ROLES: Final[tuple[str, ...]] = tuple(role for role in ROLES if role != MOTION_ACTION)
"""Roles an action's argument may bear; ARGM-MA is reserved for motion-action edges."""

ROLE_INDEX: Final[dict[str, int]] = {role: index for index, role in enumerate(ROLES)}
