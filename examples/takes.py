"""Generate several takes of one sentence and choose one. They share the runs of the models."""

import numpy as np

from kinegraph import MotionPipeline

pipe = MotionPipeline.load()
takes = pipe.takes("a person walks and turns to the left", 4, seconds=4, seed=20)
for clip in takes:
    travel = np.linalg.norm(np.diff(clip.joints[:, 0, [0, 2]], axis=0), axis=1).sum()
    clip.save(f"turn_{clip.seed}.bvh", names="mixamo", force=True)
    print(f"turn_{clip.seed}.bvh: {travel:.1f} m of way")

best = takes[2]
best.looped().save("best.glb", force=True)
print(f"seed {best.seed}, {best.duration:g} s: best.glb")
