"""Use kinegraph in a program, in ten lines."""

from kinegraph import MotionPipeline

pipe = MotionPipeline.load()  # load once; any number of threads may share it
clip = pipe.generate("a person walks forward", seconds=4, seed=7)
clip.save("walk.glb", force=True)
print(f"{clip.frames} frames at {clip.fps:g} per second, seed {clip.seed}")
hips = clip.joints[:, 0]  # (frames, 3) metres, Y up
print(f"the hips travel {hips[-1, 2] - hips[0, 2]:.1f} m ahead")
