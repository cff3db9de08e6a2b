"""Show progress and cancel a run: `on_step` is called after every diffusion step; returning False stops."""

import time

from kinegraph import Cancelled, MotionPipeline, StepInfo

pipe = MotionPipeline.load()


def show(step: StepInfo) -> bool:
    print(f"\r{100 * step.done // step.total:3} %, {step.level} {step.step} of {step.steps} ", end="", flush=True)
    return True


clip = pipe.generate("a person bows", seconds=3, seed=1, on_step=show)
print(f"\r{clip.duration:g} seconds of motion".ljust(50))

deadline = time.monotonic() + 0.002
try:
    pipe.generate("a person runs", seconds=9, seed=1, on_step=lambda step: time.monotonic() < deadline)
    print("done in time")
except Cancelled as stopped:
    print(f"out of time: {stopped}")
