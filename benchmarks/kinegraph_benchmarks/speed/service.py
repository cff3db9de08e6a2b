"""Measure what the service adds to a clip, and what retargeting costs.

    python -m kinegraph_benchmarks.speed.service --out service.json

`kinegraph serve` runs as a process of its own. The same clip of four seconds is made here and asked for there, in
turns; both times end with the bytes of a .glb. Then a clip is put on a character again and again: our own body, or that
of --character. Writes JSON, prints a table.

Needs the extras text and play.
"""

from __future__ import annotations

import http.client
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.clip import Clip
from kinegraph.formats import encode
from kinegraph.formats.character import read_character
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_json

TEXT = "a person walks forward while waving the right hand"
SECONDS = 4
WARM_UP = 3


def measure_service(pipe: MotionPipeline, bundle: Path | None, repeats: int) -> dict[str, list[float]]:
    """Time clips made here and clips asked for, in turns; milliseconds."""
    command = [sys.executable, "-m", "kinegraph", "serve", "--port", "0"]
    command += [] if bundle is None else ["--bundle", str(bundle)]
    times: dict[str, list[float]] = {"in process": [], "by the service": []}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            port = int(server.stdout.readline().split("//")[1].split("/")[0].split(":")[1])
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
            for seed in range(repeats + WARM_UP):
                arms = {
                    "in process": lambda seed=seed: encode(pipe.generate(TEXT, seconds=SECONDS, seed=seed), ".glb"),
                    "by the service": lambda seed=seed: ask(connection, seed),
                }
                found = {name: timed(arm) for name, arm in arms.items()}
                if seed >= WARM_UP:
                    for name, (milliseconds, _) in found.items():
                        times[name].append(milliseconds)
                assert len({data for _, data in found.values()}) == 1, "the service made another clip"
            connection.close()
        finally:
            server.terminate()
    return times


def ask(connection: http.client.HTTPConnection, seed: int) -> bytes:
    """Ask the service for a clip."""
    wanted = json.dumps({"text": TEXT, "seconds": SECONDS, "seed": seed, "format": "glb"})
    connection.request("POST", "/v1/clips", wanted, {"Content-Type": "application/json"})
    response = connection.getresponse()
    data = response.read()
    if response.status != 200:
        sys.exit(data.decode())
    return data


def measure_retargeting(clip: Clip, character: Path | None, repeats: int) -> list[float]:
    """Time a clip on a character that has been read, to the bytes of its .glb; milliseconds."""
    with tempfile.TemporaryDirectory() as folder:
        path = character or Path(folder) / "body.glb"
        if character is None:
            clip.save(path)
        hero = read_character(path)
    for _ in range(WARM_UP):
        clip.onto(hero).encode()
    return [timed(clip.onto(hero).encode)[0] for _ in range(repeats)]


def timed(call: Callable[[], bytes]) -> tuple[float, bytes]:
    """Time one call; milliseconds, and what it returns."""
    start = time.perf_counter()
    data = call()
    return 1000 * (time.perf_counter() - start), data


def summary(values: list[float]) -> dict[str, float]:
    """Compute the quantiles that are reported."""
    return {"count": len(values), "p50": float(np.median(values)), "p95": float(np.percentile(values, 95))}


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "bundle", repeats=50)
    parser.add_argument("--character", type=Path, help=".glb or .vrm; our own body without it")
    parser.add_argument("--out", type=Path, required=True, help="JSON file with every repeat")
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle)
    times: dict[str, Any] = dict(measure_service(pipe, options.bundle, options.repeats))
    clip = pipe.generate(TEXT, seconds=SECONDS, seed=1)
    times["onto a character"] = measure_retargeting(clip, options.character, options.repeats)
    result = {name: summary(values) for name, values in times.items()}
    added = float(np.median(np.subtract(times["by the service"], times["in process"])))
    write_json(options.out, {"summary": result, "added_by_the_service_ms": added, "repeats_ms": times})
    print("| a clip of 4 s, milliseconds | p50 | p95 |\n|---|---|---|")
    for name, row in result.items():
        print(f"| {name} | {row['p50']:.1f} | {row['p95']:.1f} |")
    print(f"\nThe service adds {added:.1f} ms (median of {options.repeats} pairs).")


if __name__ == "__main__":
    main()
