"""Edit the semantic graph of a sentence: look at it, weigh one edge, replace words, keep it as JSON."""

import json
from pathlib import Path

import numpy as np

from kinegraph import Clip, MotionPipeline, SemanticGraph
from kinegraph.edits import replaced, with_weight
from kinegraph.motion.skeleton import facing_angle


def turn(clip: Clip) -> float:
    heading = facing_angle(clip.joints)
    return float(np.degrees(heading[-1] - heading[0]))


pipe = MotionPipeline.load()
graph = pipe.parse("a tired person walks and turns to the right")
print("parts:", [node.text for node in graph.nodes])
for weight in (0.5, 0.75, 1.0):
    clip = pipe.generate(with_weight(graph, "to the right", weight), seconds=4, seed=6)
    print(f"to the right at {weight:g}: turns by {turn(clip):.0f} degrees")

other = replaced(graph, "to the right", "to the left")
print(f"{other.caption}: {turn(pipe.generate(other, seconds=4, seed=6)):.0f} degrees")
Path("graph.json").write_text(json.dumps(other.to_dict(), indent=2))  # edit it by hand, and read it again
print(SemanticGraph.from_json(Path("graph.json").read_text()) == other)
