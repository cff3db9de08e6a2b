"""kinegraph: text to human motion on a plain CPU.

from kinegraph import MotionPipeline

pipe = MotionPipeline.load()
clip = pipe.generate("a person walks forward and waves", seconds=4, seed=7)
clip.save("walk.bvh")
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from kinegraph.clip import Clip
    from kinegraph.concepts import Concept
    from kinegraph.constraints import EndPose, JointTarget, Keyframe, Loop, Miss, Path, StartPose, Waypoint
    from kinegraph.diffusion.sampling import StepInfo
    from kinegraph.errors import (
        BundleError,
        BundleFormatError,
        BundleIntegrityError,
        Cancelled,
        InvalidGraphError,
        InvalidInputError,
        KinegraphError,
        MissedConstraintError,
        MissingExtraError,
        ModelError,
        NonFiniteError,
        OutputError,
        TimedOut,
        UnknownWordsError,
    )
    from kinegraph.graph import SemanticGraph
    from kinegraph.pipeline import MotionPipeline
    from kinegraph.unknown import Unknown

__version__ = "0.9.0"

# From 1.32 on, importing onnxruntime writes a device number into the user's home and may send events to its maker. Turn
# that off, unless the host has set the variable or has imported onnxruntime already.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

# Imported at first use: `kinegraph --help`, or a program that only reads clips, need not wait for onnxruntime.
_MODULES: Final[dict[str, str]] = {
    "BundleError": "kinegraph.errors",
    "BundleFormatError": "kinegraph.errors",
    "BundleIntegrityError": "kinegraph.errors",
    "Cancelled": "kinegraph.errors",
    "Clip": "kinegraph.clip",
    "Concept": "kinegraph.concepts",
    "EndPose": "kinegraph.constraints",
    "InvalidGraphError": "kinegraph.errors",
    "InvalidInputError": "kinegraph.errors",
    "JointTarget": "kinegraph.constraints",
    "Keyframe": "kinegraph.constraints",
    "KinegraphError": "kinegraph.errors",
    "Loop": "kinegraph.constraints",
    "Miss": "kinegraph.constraints",
    "MissedConstraintError": "kinegraph.errors",
    "MissingExtraError": "kinegraph.errors",
    "ModelError": "kinegraph.errors",
    "MotionPipeline": "kinegraph.pipeline",
    "NonFiniteError": "kinegraph.errors",
    "OutputError": "kinegraph.errors",
    "Path": "kinegraph.constraints",
    "SemanticGraph": "kinegraph.graph",
    "StartPose": "kinegraph.constraints",
    "StepInfo": "kinegraph.diffusion.sampling",
    "TimedOut": "kinegraph.errors",
    "Unknown": "kinegraph.unknown",
    "UnknownWordsError": "kinegraph.errors",
    "Waypoint": "kinegraph.constraints",
}

__all__ = [
    "BundleError",
    "BundleFormatError",
    "BundleIntegrityError",
    "Cancelled",
    "Clip",
    "Concept",
    "EndPose",
    "InvalidGraphError",
    "InvalidInputError",
    "JointTarget",
    "Keyframe",
    "KinegraphError",
    "Loop",
    "Miss",
    "MissedConstraintError",
    "MissingExtraError",
    "ModelError",
    "MotionPipeline",
    "NonFiniteError",
    "OutputError",
    "Path",
    "SemanticGraph",
    "StartPose",
    "StepInfo",
    "TimedOut",
    "Unknown",
    "UnknownWordsError",
    "Waypoint",
]


def __getattr__(name: str) -> object:
    module = _MODULES.get(name)
    if module is None:
        raise AttributeError(f"module 'kinegraph' has no attribute {name!r}")
    return getattr(import_module(module), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
