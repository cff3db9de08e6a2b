"""`kinegraph timeline FILE`, and `--space` of the other commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("spacy")

from kinegraph import MotionPipeline
from kinegraph.cli import main
from kinegraph.formats import read
from kinegraph.intervals import Interval

WALKS, WAVES = "a person walks forward", "a person waves the right hand"


def run(*words: str, bundle: Path) -> int:
    return main([*words, "--bundle", str(bundle), "--quiet"])


def test_a_file_becomes_a_clip(toy: MotionPipeline, toy_bundle: Path, here: Path) -> None:
    (here / "scene.txt").write_text(f"{WALKS} # 0 # 2\n{WAVES} # 2 # 4 # right arm\n", encoding="utf-8")
    words = ("timeline", "scene.txt", "--space", "frames", "--overlap", "0.4", "--seed", "3", "-o", "scene.npz")
    assert run(*words, bundle=toy_bundle) == 0
    timeline = [Interval(WALKS, 0, 2), Interval(WAVES, 2, 4, ("right arm",))]
    expected = toy.timeline(timeline, overlap=0.4, space="frames", seed=3)
    np.testing.assert_array_equal(read("scene.npz").joints, expected.joints)


def test_a_timeline_takes_a_path(toy: MotionPipeline, toy_bundle: Path, here: Path) -> None:
    (here / "scene.txt").write_text(f"{WALKS} # 0 # 2\n", encoding="utf-8")
    words = (
        "timeline",
        "scene.txt",
        "--path",
        "0,0 0.3,1",
        "--constraint-weight",
        "2",
        "--seed",
        "3",
        "-o",
        "scene.npz",
    )
    assert run(*words, "--space", "frames", bundle=toy_bundle) == 0
    assert np.linalg.norm(read("scene.npz").joints[-1, 0, [0, 2]] - [0.3, 1.0]) < 0.02
    assert run(*words, "--force", bundle=toy_bundle) == 2


def test_commands_sample_in_skeleton_space(toy: MotionPipeline, toy_bundle: Path, here: Path) -> None:
    options = ("--seconds", "2", "--seed", "3", "--space", "frames")
    assert run("generate", WALKS, *options, "-o", "walk.npz", bundle=toy_bundle) == 0
    expected = toy.generate(WALKS, seconds=2, seed=3, space="frames")
    np.testing.assert_array_equal(read("walk.npz").joints, expected.joints)
    assert run("compose", "--and", WALKS, "--and", WAVES, *options, "-o", "both.npz", bundle=toy_bundle) == 0
    expected = toy.compose([WALKS, WAVES], seconds=2, seed=3, space="frames")
    np.testing.assert_array_equal(read("both.npz").joints, expected.joints)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("timeline", "none.txt"), "cannot read 'none.txt'"),
        (("timeline", "parts.txt"), 'take space="frames"'),
        (("generate", WALKS, "--space", "time"), "space must be one of latent, frames"),
        (("compose", "--and", WALKS, "--space", "frames", "--energy", "e.png"), "--energy draws latent space"),
    ],
)
def test_what_cannot_be_is_told_and_nothing_is_written(
    words: tuple[str, ...], message: str, toy_bundle: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "parts.txt").write_text(f"{WALKS} # 0 # 2 # legs\n", encoding="utf-8")
    assert run(*words, "-o", "clip.npz", bundle=toy_bundle) == 2
    assert message in capsys.readouterr().err and not (here / "clip.npz").exists()
