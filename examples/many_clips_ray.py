"""Make clips of many sentences on all machines of a Ray cluster; without a cluster, on all cores of this machine.

pip install "ray[data]" kinegraph[text]; every machine needs both. `kinegraph batch` does the same on one machine.
"""

from pathlib import Path

import ray

from kinegraph import MotionPipeline

FOLDER = Path("clips").resolve()  # on a cluster: a folder that all machines share
SENTENCES = ["a person walks forward", "a person bows", "a person runs", "a person waves the right hand"]


class MakeClips:
    """One per core: loads the bundle once."""

    def __init__(self) -> None:
        self.pipe = MotionPipeline.load(threads=1)

    def __call__(self, row: dict) -> dict:
        clip = self.pipe.generate(row["text"], seconds=3, seed=int(row["seed"]))
        file = FOLDER / f"{row['seed']:06}.npz"
        clip.save(file, force=True)
        return {"file": file.name, "text": clip.text, "seed": clip.seed, "frames": clip.frames}


FOLDER.mkdir(exist_ok=True)
rows = ray.data.from_items([{"text": text, "seed": seed} for seed, text in enumerate(SENTENCES)])
made = rows.map(MakeClips, compute=ray.data.ActorPoolStrategy(size=2), num_cpus=1).take_all()
for record in sorted(made, key=lambda record: record["seed"]):
    print(f"{record['file']}: {record['frames']} frames, {record['text']}")
