"""Print the SHA-256 of the joints that fixed seeds give, one line for each way to make a clip.

    python tests/support/joint_hashes.py [BUNDLE_FOLDER] > before.txt

Run it before and after a change that must not change motion, on the same machine and with the same onnxruntime, and
compare the lines. Hashes of two kinds of CPU differ, so none are kept in the repository.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable

from kinegraph import Clip, Concept, MotionPipeline
from kinegraph.edits import replaced, with_weight, without

WALK, WAVE = "a person walks forward", "a person waves the right hand"


def hash_joints(clips: Iterable[Clip]) -> str:
    """Hash the joints of clips, in order."""
    digest = hashlib.sha256()
    for clip in clips:
        digest.update(clip.joints.tobytes())
    return digest.hexdigest()


def joint_hashes(pipe: MotionPipeline) -> dict[str, str]:
    """Make clips with fixed seeds in every way there is and hash their joints."""
    concepts = [Concept(WALK), Concept(WAVE, 0.8)]
    graph = pipe.parse("a person walks slowly to the left")
    edited = with_weight(replaced(without(graph, "slowly"), "walks", "runs"), "to the left", 1.5)
    clips = {
        "generate": [pipe.generate(WALK, seconds=4, seed=7)],
        "generate, own length": [pipe.generate("a person walks and turns right", seed=3)],
        "compose latent": [pipe.compose(concepts, method="latent", seconds=3, seed=7)],
        "compose semantic": [pipe.compose(concepts, method="semantic", seconds=3, seed=7)],
        "compose fused": [pipe.compose(concepts, method="fused", seconds=3, seed=7)],
        "compose fused, agd": [pipe.compose(concepts, agd=(0.1, 0.1), seconds=3, seed=7)],
        "negation": [pipe.compose([Concept(WALK), Concept("a person runs", -0.3)], seconds=3, seed=7)],
        "takes": pipe.takes(WALK, 3, seconds=3, seed=7),
        "batch": pipe.batch([WALK, "a person bows"], takes=2, seconds=[3, 2], seed=7),
        "sequence": [pipe.sequence([WALK, "a person turns left", "a person bows"], seconds=[3, 2, 3], seed=7)],
        "edited graph": [pipe.generate(edited, seconds=4, seed=7)],
        "loop in place": [pipe.generate(WALK, seconds=4, seed=7).looped().in_place().resampled(30)],
    }
    return {name: hash_joints(group) for name, group in clips.items()}


if __name__ == "__main__":
    for name, value in joint_hashes(MotionPipeline.load(*sys.argv[1:2])).items():
        print(f"{value}  {name}")
