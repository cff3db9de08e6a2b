"""Takes of one sentence, to choose from. They share the runs of the models, and take k is the clip of seed + k."""

import numpy as np

from kinegraph import MotionPipeline

pipe = MotionPipeline.load(threads=2)
takes = pipe.takes("a person walks and turns to the left", 4, seconds=4, seed=20)
for clip in takes:
    travel = np.linalg.norm(np.diff(clip.joints[:, 0, [0, 2]], axis=0), axis=1).sum()
    clip.save(f"turn_{clip.seed}.bvh", names="mixamo", force=True)
    print(f"turn_{clip.seed}.bvh: {travel:.1f} m of way")

best = pipe.generate("a person walks and turns to the left", seconds=4, seed=takes[2].seed)  # the third one again
print(f"seed {best.seed} again, to {1000 * np.abs(best.joints - takes[2].joints).max():.2f} mm")
