"""Generate clips in threads of an asyncio program: the event loop stays free, and a timeout stops the models."""

import asyncio
import threading

from kinegraph import Clip, MotionPipeline


async def generate(pipe: MotionPipeline, text: str, seconds: float, timeout: float) -> Clip:
    stop = threading.Event()
    work = asyncio.to_thread(pipe.generate, text, on_step=lambda step: not stop.is_set(), seconds=seconds)
    try:
        return await asyncio.wait_for(work, timeout)
    finally:
        stop.set()  # after a timeout or a cancellation, the thread ends with its present step


async def main() -> None:
    pipe = await asyncio.to_thread(MotionPipeline.load, threads=1)
    texts = ["a person walks forward", "a person waves the right hand", "a person bows"]
    clips = await asyncio.gather(*(generate(pipe, text, seconds=3, timeout=60) for text in texts))
    for clip in clips:
        print(f"{clip.text}: {clip.frames} frames")
    try:
        await generate(pipe, "a person runs", seconds=9, timeout=0.001)
    except TimeoutError:
        print("a person runs: too late, stopped")


asyncio.run(main())
