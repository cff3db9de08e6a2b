"""Compose several motions at once, then several one after another, and make a loop for a game."""

from kinegraph import Concept, MotionPipeline

pipe = MotionPipeline.load()
clip = pipe.compose(
    [Concept("a person walks forward"), Concept("a person waves the right hand"), Concept("a person runs", -0.3)],
    seconds=4,
    seed=7,
)
clip.save("walk_waving.glb", force=True)
print(f"walk_waving.glb: {clip.text}")

scene = pipe.sequence(["a person walks forward", "a person turns left", "a person bows"], seconds=[3, 2, 3], seed=7)
scene.save("scene.glb", force=True)
print(f"scene.glb: {scene.duration:g} seconds: {scene.text}")

walk = pipe.generate("a person walks forward", seconds=4, seed=7)
walk.looped().in_place().resampled(60).save("walk_cycle.glb", force=True)  # the game moves the character
print("walk_cycle.glb: a loop in place at 60 frames per second")
