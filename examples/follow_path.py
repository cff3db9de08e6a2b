"""Walk along a path, then wave where it ends: constraints say where and when, and the clip says how near it came."""

from kinegraph import JointTarget, MotionPipeline, Path, StartPose

pipe = MotionPipeline.load()
path = Path([(0, 0), (0.5, 1), (0, 2), (-0.5, 3)], heading="along")
walk = pipe.generate("a person walks forward", seconds=4, seed=7, constraints=[path])
walk.save("walk_along.glb", force=True)

hand = JointTarget("right hand", (None, 1.6, None), (1.5, 2))
wave = pipe.generate("a person waves the right hand", seconds=3, seed=7, constraints=[StartPose(walk), hand])
wave.save("wave_after.glb", force=True)

for clip in (walk, wave):
    for miss in clip.misses:
        print(f"{clip.text}: {miss.what}, {100 * miss.metres:.1f} cm off")
