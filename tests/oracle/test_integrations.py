"""The add-on for Blender, used in headless Blender against a service; the other integrations as far as can be read."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph.motion.skeleton import JOINT_INDEX
from support.characters import BUILDS, make_character
from support.readers import blender_problem

pytest.importorskip("spacy")
pytest.importorskip("starlette")

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "integrations"


def test_the_add_on_makes_clips_and_moves_the_selected_armature(
    tmp_path: Path, toy: MotionPipeline, figure: Callable[[str], None]
) -> None:
    if blender_problem():
        pytest.skip(blender_problem())
    import threading

    from kinegraph.playground.server import open_socket
    from kinegraph.service.app import Service
    from kinegraph.service.server import ServiceServer

    build = BUILDS["Unreal, A-pose, Z up, twist"]
    hero = tmp_path / "hero.glb"
    hero.write_bytes(make_character(build, lambda document: document.pop("animations")))
    with open_socket(None, 0, None) as listener:
        port = listener.getsockname()[1]
        server = ServiceServer(Service(toy), port)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        command = ["blender", "-b", "--python-exit-code", "1", "--python", str(ROOT / "tests/oracle/blender_addon.py")]
        command += ["--", str(FOLDER / "blender_kinegraph.py"), f"http://127.0.0.1:{port}"]
        command += [f"{sys.executable} -m kinegraph", str(hero)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
        server.should_exit = True
        thread.join(20)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    report = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    assert report["made"] == report["onto"] == ["FINISHED"]
    assert report["actions"] == ["a person walks 5", "a person walks 6"]
    assert report["action"].startswith("a person walks 5") and report["left_over"] == 0
    assert "CANCELLED" in report["empty"] or "text" in report["empty"] or "caption" in report["empty"]
    clip = toy.generate("a person walks", seconds=2, seed=5)
    points = np.array(report["points"])
    assert len(points) == clip.frames
    worst = 0.0
    for upper, lower, ours in ((3, 4, ("right_shoulder", "right_elbow")), (4, 5, ("right_elbow", "right_wrist"))):
        theirs = points[:, lower] - points[:, upper]
        bones = clip.joints[:, JOINT_INDEX[ours[1]]] - clip.joints[:, JOINT_INDEX[ours[0]]]
        cosine = (theirs * bones).sum(-1) / np.linalg.norm(theirs, axis=-1) / np.linalg.norm(bones, axis=-1)
        worst = max(worst, float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).max()))
    figure(f"the add-on in Blender: the arm of the selected armature is at most {worst:.2f} degrees from ours")
    assert worst < 2.0


def test_the_other_programs_ask_for_what_the_service_takes() -> None:
    from kinegraph.service.openapi import openapi

    paths = openapi()["paths"]
    for name in ("godot/kinegraph.gd", "unity/KinegraphClip.cs", "three/index.html"):
        text = (FOLDER / name).read_text(encoding="utf-8")
        assert set(re.findall(r"/v1/\w+", text)) <= set(paths)
        assert "127.0.0.1:8421" in text and '"text' in text.replace("'", '"').replace('\\"', '"')
