"""Measure constraints: how near clips come, how natural they stay, whether the text still holds, and what it costs.

    python -m kinegraph_benchmarks.quality.constraints --data DATA/bandai --out constraints.json

    ... --cases N                   of each kind (50)
    ... --kinds "path,hand"         some kinds only
    ... --curve-cases N             of each point of the curves against weight and number of keys (10; 0 is none)

Each case of `common.constraint_cases` is made three times with one seed: plain, by the energies alone, and with the
correction after them. Misses are measured here, not taken from the clip. Jerk and skate are ratios to the plain clip,
beside those of the captured clip that a case is drawn from: where the plain clip strolls and the captured one strides,
no clip can do what is asked and stay as calm as the plain one. The Frechet distance is to captured clips beside that of
the plain ones, and time is CPU time of one thread, as a ratio to the plain clip made just before. Writes JSON, and a
Markdown table beside it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from kinegraph import Clip, EndPose, JointTarget, Keyframe, Loop, MotionPipeline, Path, StartPose, Waypoint
from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.constraints import Constraint
from kinegraph.feasibility import frame_of
from kinegraph.motion.skeleton import HORIZONTAL, PELVIS, facing_angle
from kinegraph.options import LATENT
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.constraint_cases import Case, floor_path, make_cases, on_common_body
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.everyday_rules import meets
from kinegraph_benchmarks.common.predicates import FPS
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_training.data.clips import MotionClip, read_split
from kinegraph_training.metrics import foot_skate, frechet_distance, jerk

SPLIT: Final = "dev_test"
ALONE_GOALS: Final = {
    "path": 0.03,
    "drawn path": 0.03,
    "waypoint": 0.03,
    "hand": 0.025,
    "foot": 0.025,
    "keyframe": 0.03,
    "start": 0.015,
    "end": 0.015,
    "loop": 0.01,
}
"""Kind -> mean miss by the energies alone, metres."""
CORRECTED_GOAL: Final = 0.005
JERK_GOAL, SKATE_GOAL, TEXT_GOAL, TIME_GOAL = 1.3, 1.2, 0.9, 6.0
SEAM_QUANTILE: Final = 0.95
"""Of captured steps: what the seam of a start or end pose is compared with, and the share of seams to be within."""
WEIGHTS: Final = (0.25, 0.5, 1.0, 2.0, 4.0)
KEYS: Final = (1, 2, 4, 8)
SMALL_SKATE: Final = 0.05
"""Metres per second: the ratio of a clip that hardly skates says nothing, so this is added to both."""


def miss(joints: FloatArray, constraint: Constraint) -> float:
    """Measure how far a clip is from a constraint: the mean distance of what it names, metres."""
    joints = joints.astype(np.float64)
    frames = len(joints)
    match constraint:
        case Path():
            times, duration = np.arange(frames) / FPS, (frames - 1) / FPS
            covered = constraint.covers(times, duration) > 0
            wanted = constraint.positions(times, duration)
            return float(np.linalg.norm(floor_path(joints)[covered] - wanted[covered], axis=1).mean())
        case Waypoint():
            frame = frame_of(constraint.seconds, frames, FPS)
            return float(np.linalg.norm(floor_path(joints)[frame] - constraint.position))
        case JointTarget():
            begin, end = (frame_of(moment, frames, FPS) for moment in constraint.interval)
            axes = [axis for axis, value in enumerate(constraint.position) if value is not None]
            place = [value for value in constraint.position if value is not None]
            path = joints[begin : end + 1, constraint.index][:, axes]
            return float(np.linalg.norm(path - place, axis=1).mean())
        case Keyframe():
            pose = joints[[frame_of(constraint.seconds, frames, FPS)]]
            wanted = constraint.joints.astype(np.float64)[None]
            if constraint.anywhere:
                pose, wanted = placed(pose, 0), placed(wanted, 0)
        case StartPose():
            wanted = constraint.frames(FPS).astype(np.float64)
            pose = joints[: len(wanted)]
        case EndPose():
            wanted = constraint.frames(FPS).astype(np.float64)
            pose = placed(joints[-len(wanted) :], -1)
        case Loop():
            pose, wanted = placed(joints[-1:], 0), placed(joints[:1], 0)
    return float(np.linalg.norm(pose - wanted, axis=-1).mean())


def placed(joints: DoubleArray, anchor: int) -> DoubleArray:
    """Move and turn frames so that frame `anchor` is above the origin and faces +Z."""
    angle = float(facing_angle(joints[[anchor]].astype(np.float32))[0])
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(joints - joints[anchor, PELVIS] * HORIZONTAL, -1, 0)
    return np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=-1)


def step_motion(joints: FloatArray) -> tuple[DoubleArray, DoubleArray]:
    """Measure the largest speed of a joint in each step, and change from step to step, m/s: (t - 1,) and (t - 2,)."""
    velocity = np.diff(joints.astype(np.float64), axis=0) * FPS
    speed, change = (np.linalg.norm(values, axis=-1).max(axis=1) for values in (velocity, np.diff(velocity, axis=0)))
    return speed, change


def seam_motion(joints: FloatArray, constraint: StartPose | EndPose) -> tuple[float, float]:
    """Measure speed and change of velocity, m/s, between the frames that are asked for and the rest."""
    count = len(constraint.frames(FPS))
    step = count - 1 if isinstance(constraint, StartPose) else len(joints) - count - 1
    speed, change = step_motion(joints)
    return float(speed[step]), float(change[max(step - 1, 0) : step + 1].max())


def asked_motion(constraint: StartPose | EndPose) -> tuple[float, float]:
    """Measure the largest speed and change of velocity, m/s, within the frames that are asked for."""
    speed, change = step_motion(constraint.frames(FPS))
    return float(speed.max(initial=0.0)), float(change.max(initial=0.0))


def seam_limits(clips: Sequence[MotionClip]) -> tuple[float, float]:
    """Compute the `SEAM_QUANTILE` of both over the steps of captured clips."""
    steps = [step_motion(clip.joints) for clip in clips]
    speed, change = (float(np.quantile(np.concatenate(values), SEAM_QUANTILE)) for values in zip(*steps, strict=True))
    return speed, change


def seams(rows: Sequence[Mapping[str, Any]], limits: tuple[float, float]) -> dict[str, Any]:
    """Compare the seams of one kind with captured steps, for each arm.

    Returns:
        Medians; the share of clips within what 95 % of captured steps are; and the share within that or what the pose
        itself does, which was captured too: a seam at the pose of a runner is as fast as he is.
    """
    summary: dict[str, Any] = {"captured": limits}
    for arm in ("plain", "alone", "corrected"):
        values = np.array([row[arm]["seam"] for row in rows])
        asked = np.maximum([row["asked_motion"] for row in rows], limits)
        within, as_asked = ((values <= bound).all(axis=1).mean() for bound in (limits, asked))
        summary[arm] = {
            "median": np.median(values, axis=0).tolist(),
            "within": float(within),
            "within_or_asked": float(as_asked),
        }
    return summary


def timed(make: Callable[[], Clip]) -> tuple[FloatArray, float]:
    """Make a clip, and measure its CPU time in seconds."""
    start = time.process_time()
    clip = make()
    return clip.joints, time.process_time() - start


def run_case(pipe: MotionPipeline, case: Case, *, weight: float = 1.0, space: str = LATENT) -> dict[str, Any]:
    """Make a case plain, by the energies alone, and corrected; measure each.

    In skeleton space, "alone" is what is held there, before the correction.

    Returns:
        Misses in metres, jerk and skate as ratios to the plain clip, CPU seconds, whether rules hold; and the joints.
    """
    shared: dict[str, Any] = {"seconds": case.seconds, "seed": case.seed, "space": space}
    plain, plain_seconds = timed(lambda: pipe.generate(case.text, **shared))
    row: dict[str, Any] = {
        "text": case.text,
        "seed": case.seed,
        "seconds": case.seconds,
        "plain": {"cpu": plain_seconds, "holds": meets(plain, case.rules), "joints": plain} | misses(plain, case),
    }
    for arm, options in (("alone", {"constraint_fix": False}), ("corrected", {})):
        joints, seconds = timed(
            lambda options=options: pipe.generate(  # type: ignore[misc]
                case.text, constraints=case.constraints, constraint_weight=weight, **shared, **options
            )
        )
        row[arm] = {"cpu": seconds, "holds": meets(joints, case.rules), "joints": joints}
        row[arm] |= roughness(joints, plain) | misses(joints, case)
    if case.captured is not None:
        row["captured"] = roughness(case.captured, plain)
    for pose in [one for one in case.constraints if isinstance(one, StartPose | EndPose)][:1]:
        row["asked_motion"] = asked_motion(pose)
        for arm in _ARMS:
            row[arm]["seam"] = seam_motion(row[arm]["joints"], pose)
    return row


def roughness(joints: FloatArray, plain: FloatArray) -> dict[str, float]:
    """Measure jerk and skate of a clip as multiples of those of the plain one."""
    skates = [np.nan_to_num(foot_skate(clip)) + SMALL_SKATE for clip in (joints, plain)]
    return {"jerk": jerk(joints) / max(jerk(plain), 1e-9), "skate": float(skates[0] / skates[1])}


def misses(joints: FloatArray, case: Case) -> dict[str, float]:
    """Measure mean and largest miss of a case's constraints."""
    values = [miss(joints, constraint) for constraint in case.constraints]
    return {"miss": float(np.mean(values)), "worst": max(values)}


def summarise(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarise the cases of one kind: a row for each arm."""
    summary: dict[str, Any] = {"cases": len(rows)}
    plain_rate = float(np.mean([row["plain"]["holds"] for row in rows]))
    for arm in ("plain", "alone", "corrected"):
        of_arm = [row[arm] for row in rows]
        told = np.array([one["miss"] for one in of_arm])
        rate = float(np.mean([one["holds"] for one in of_arm]))
        summary[arm] = {
            "miss_mean": float(told.mean()),
            "miss_median": float(np.median(told)),
            "miss_p95": float(np.quantile(told, 0.95)),
            "rate": rate,
        }
        if arm != "plain":
            ratios = [row[arm]["cpu"] / row["plain"]["cpu"] for row in rows]
            summary[arm] |= {
                "text_kept": rate / plain_rate if plain_rate else None,
                "time": float(np.median(ratios)),
            } | median_roughness(of_arm)
    of_captured = [row["captured"] for row in rows if "captured" in row]
    if of_captured:
        summary["captured"] = median_roughness(of_captured)
    return summary


def median_roughness(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Take the medians of jerk and skate."""
    return {name: float(np.median([row[name] for row in rows])) for name in ("jerk", "skate")}


def frechet(rows: Sequence[Mapping[str, Any]], captured: FloatArray, evaluator: Evaluator) -> dict[str, float]:
    """Compute the Frechet distance of each arm's clips to embeddings (n, e) of captured ones."""
    return {
        arm: frechet_distance(evaluator.embed_motions([row[arm]["joints"] for row in rows]), captured)
        for arm in ("plain", "alone", "corrected")
    }


def weight_curve(pipe: MotionPipeline, cases: Mapping[str, Sequence[Case]], count: int) -> list[dict[str, Any]]:
    """Measure some kinds at several weights."""
    rows = []
    for kind in [kind for kind in ("drawn path", "hand", "keyframe") if kind in cases]:
        for weight in WEIGHTS:
            made = [run_case(pipe, case, weight=weight) for case in cases[kind][:count]]
            rows.append({"kind": kind, "weight": weight} | summarise(made))
    return rows


def key_curve(pipe: MotionPipeline, cases: Sequence[Case], count: int) -> list[dict[str, Any]]:
    """Measure the drawn paths as waypoints, few or many."""
    rows = []
    for keys in KEYS:
        sparse = [replace(case, constraints=waypoints_of(case, keys)) for case in cases[:count]]
        rows.append({"keys": keys} | summarise([run_case(pipe, case) for case in sparse]))
    return rows


def waypoints_of(case: Case, keys: int) -> tuple[Waypoint, ...]:
    """Turn the path of a case into waypoints, evenly spread over its time."""
    (path,) = case.constraints
    assert isinstance(path, Path)
    frames = round(case.seconds * FPS)
    duration = (frames - 1) / FPS
    times = np.linspace(0.0, duration, keys + 1)[1:]
    return tuple(
        Waypoint(float(moment), (float(x), float(z)))
        for moment, (x, z) in zip(times, path.positions(times, duration), strict=True)
    )


def goals_met(kind: str, summary: Mapping[str, Any]) -> dict[str, bool]:
    """Tell which goals of issue 25 a kind meets."""
    alone, corrected = summary["alone"], summary["corrected"]
    met = {
        "alone": kind not in ALONE_GOALS or alone["miss_mean"] <= ALONE_GOALS[kind],
        "corrected": corrected["miss_mean"] <= CORRECTED_GOAL,
        "jerk": corrected["jerk"] <= JERK_GOAL,
        "skate": corrected["skate"] <= SKATE_GOAL,
        "text": corrected["text_kept"] is None or corrected["text_kept"] >= TEXT_GOAL,
        "time": corrected["time"] <= TIME_GOAL,
    }
    if "seams" in summary:
        met["seam"] = summary["seams"]["corrected"]["within"] >= SEAM_QUANTILE
    return met


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown."""
    lines = [
        f"{result['bundle']}, {result['cases']} cases a kind, seeds from 70,000; misses in cm, mean (95 %);"
        " jerk and skate as multiples of those of the plain clip (in brackets: of the captured clip that did the same)",
        "",
        "| kind | plain | energies alone | corrected | jerk | skate | Frechet plain, corrected | text plain, corrected"
        " | time | not met |",
        "|---" * 10 + "|",
    ]
    for kind, row in result["kinds"].items():
        cells = [f"{100 * row[arm]['miss_mean']:.1f} ({100 * row[arm]['miss_p95']:.1f})" for arm in _ARMS]
        fid = row["frechet"]
        cells += [_ratio(row, "jerk"), _ratio(row, "skate")]
        cells += [f"{fid['plain']:.3f}, {fid['corrected']:.3f}"]
        cells += [f"{row['plain']['rate']:.2f}, {row['corrected']['rate']:.2f}", f"{row['corrected']['time']:.1f} x"]
        cells += [", ".join(name for name, met in row["met"].items() if not met) or "-"]
        lines.append(f"| {kind} | " + " | ".join(cells) + " |")
    for kind in [kind for kind, row in result["kinds"].items() if "seams" in row]:
        lines += ["", _seam_line(kind, result["kinds"][kind]["seams"])]
    if result["weights"]:
        lines += ["", "| kind | weight | alone, cm | corrected, cm | jerk | text |", "|---" * 6 + "|"]
    for row in result["weights"]:
        lines.append(f"| {row['kind']} | {row['weight']:g} | " + _curve_cells(row))
    if result["keys"]:
        lines += ["", "| waypoints | alone, cm | corrected, cm | jerk | text |", "|---" * 5 + "|"]
    for row in result["keys"]:
        lines.append(f"| {row['keys']} | " + _curve_cells(row))
    return "\n".join(lines) + "\n"


_ARMS: Final = ("plain", "alone", "corrected")


def _ratio(row: Mapping[str, Any], name: str) -> str:
    captured = f" ({row['captured'][name]:.2f})" if "captured" in row else ""
    return f"{row['corrected'][name]:.2f} x{captured}"


def _seam_line(kind: str, row: Mapping[str, Any]) -> str:
    speed, change = row["corrected"]["median"]
    return (
        f"Seams of {kind}: the fastest joint has {speed:.2f} m/s, and its velocity changes by {change:.2f} m/s;"
        f" {100 * row['corrected']['within']:.0f} % within captured 95 %, {row['captured'][0]:.2f} and"
        f" {row['captured'][1]:.2f} m/s, {100 * row['corrected']['within_or_asked']:.0f} % within that or what the pose"
        f" itself does (plain clips: {100 * row['plain']['within']:.0f} %)."
    )


def _curve_cells(row: Mapping[str, Any]) -> str:
    alone, corrected = (f"{100 * row[arm]['miss_mean']:.1f}" for arm in ("alone", "corrected"))
    return f"{alone} | {corrected} | {row['corrected']['jerk']:.2f} x | {row['corrected']['rate']:.2f} |"


def measure(
    pipe: MotionPipeline,
    clips: Sequence[MotionClip],
    count: int,
    curve_count: int,
    evaluator: Evaluator,
    only: Collection[str] | None = None,
) -> dict[str, Any]:
    """Measure all kinds, or some, and their curves; see `main`."""
    cases = make_cases(clips, count)
    if only is not None:
        cases = {kind: of_kind for kind, of_kind in cases.items() if kind in only}
    captured = evaluator.embed_motions([clip.joints for clip in clips])
    limits = seam_limits(clips)
    kinds: dict[str, Any] = {}
    for kind, of_kind in cases.items():
        rows = [run_case(pipe, case) for case in of_kind]
        kinds[kind] = summarise(rows) | {"frechet": frechet(rows, captured, evaluator)}
        if kind in ("start", "end"):
            kinds[kind]["seams"] = seams(rows, limits)
        kinds[kind]["met"] = goals_met(kind, kinds[kind])
        kinds[kind]["rows"] = [without_joints(row) for row in rows]
        print(kind, kinds[kind]["corrected"], flush=True)
    return {
        "bundle": f"{pipe.manifest.name} {pipe.manifest.version}",
        "cases": count,
        "kinds": kinds,
        "weights": weight_curve(pipe, cases, curve_count) if curve_count else [],
        "keys": key_curve(pipe, cases["drawn path"], curve_count) if curve_count and "drawn path" in cases else [],
    }


def without_joints(row: Mapping[str, Any]) -> dict[str, Any]:
    """Leave the joints out of a row, for JSON."""
    return {
        key: {name: one for name, one in value.items() if name != "joints"} if isinstance(value, dict) else value
        for key, value in row.items()
    }


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--cases", type=int, default=50, help="cases of each kind (50)")
    parser.add_argument("--kinds", help="some kinds, with commas between; default: all")
    parser.add_argument("--curve-cases", type=int, default=10, help="cases of each point of the curves (10)")
    add_arguments(parser, "data", "bundle", "out")
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle, threads=1)
    pipe.generate("a person walks forward", seconds=1, seed=1)  # opens the sessions
    clips = on_common_body(read_split(options.data, SPLIT))
    only = None if options.kinds is None else options.kinds.split(",")
    result = measure(pipe, clips, options.cases, options.curve_cases, Evaluator(), only)
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
