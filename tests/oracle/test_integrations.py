"""The add-on for Blender, used in headless Blender against a service; the other integrations as far as can be read."""

from __future__ import annotations

import json
import re
import shutil
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
    assert report["made_path"] == report["onto_path"] == ["FINISHED"] and report["path_left_over"] == 0
    # the path that was asked for is the bend, from its start and ahead along it
    bend = np.array(report["bend"])[:, [0, 2]]
    asked = np.array(report["asked"])
    np.testing.assert_allclose(asked[0], 0, atol=1e-5)
    assert abs(asked[1, 0]) < 1e-4 < asked[1, 1]
    np.testing.assert_allclose(np.linalg.norm(asked[-1]), np.linalg.norm(bend[-1] - bend[0]), atol=1e-4)
    assert asked[-1, 0] < 0  # the bend is to the right of who walks it
    off = {}
    for name, walked in report["walked"].items():
        pelvis = np.array(walked)[:, 0][:, [0, 2]]
        off[name] = float(np.linalg.norm(pelvis[:, None] - bend, axis=-1).min(axis=1).max())
        assert np.linalg.norm(pelvis[0] - bend[0]) < 0.05 and np.linalg.norm(pelvis[-1] - bend[-1]) < 0.25
    figure(f"the add-on in Blender: metres from the curve at most: {off}")
    assert max(off.values()) < 0.2
    figure(f"the add-on in Blender: the arm of the selected armature is at most {worst:.2f} degrees from ours")
    assert worst < 2.0


def test_the_other_programs_ask_for_what_the_service_takes() -> None:
    from kinegraph.service.openapi import openapi

    paths = openapi()["paths"]
    for name in ("godot/kinegraph.gd", "unity/KinegraphClip.cs", "three/index.html"):
        text = (FOLDER / name).read_text(encoding="utf-8")
        assert set(re.findall(r"/v1/\w+", text)) <= set(paths)
        assert "127.0.0.1:8421" in text and '"text' in text.replace("'", '"').replace('\\"', '"')


def test_the_script_for_unity_compiles(tmp_path: Path) -> None:
    compiler = shutil.which("mcs")
    if compiler is None:
        pytest.skip("needs a C# compiler: apt-get install mono-mcs")
    sources = [FOLDER / "unity" / "KinegraphClip.cs", Path(__file__).with_name("unity_stubs.cs")]
    command = [compiler, "-target:library", f"-out:{tmp_path / 'all.dll'}", "-warnaserror+", "-nowarn:649"]
    done = subprocess.run([*command, *map(str, sources)], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_script_for_godot_parses() -> None:
    parser = pytest.importorskip("gdtoolkit.parser", reason="needs a parser of GDScript: pip install gdtoolkit").parser
    tree = parser.parse((FOLDER / "godot" / "kinegraph.gd").read_text(encoding="utf-8"), gather_metadata=True)
    names = {node.children[0].children[0].value for node in tree.find_data("func_def")}
    assert names == {"_ready", "play", "_on_answer"}
