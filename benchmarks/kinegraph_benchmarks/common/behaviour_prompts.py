"""The behaviours that benchmarks ask for: prompts in words of our own, and the predicate that each must meet."""

from __future__ import annotations

from dataclasses import dataclass

from kinegraph_benchmarks.common import predicates as p


@dataclass(frozen=True)
class Behaviour:
    """One class of motion: how it is asked for, and how it is recognised."""

    name: str
    prompts: tuple[str, ...]
    holds: p.Predicate
    action: str
    """Label of the captured clips that it is compared with."""
    style: str | None = None
    """Style of those clips; None for any."""
    gated: bool = True
    """Whether it counts for passing; rare classes are reported only."""


FORWARD = p.goes(1, 1, 0.5)
"""Ends more than half a metre ahead."""


def _raise(side: str) -> Behaviour:
    """Describe raising the left hand, the right hand, or both."""
    hand = "both hands" if side == "both" else f"the {side} hand"
    arm = "both arms" if side == "both" else f"their {side} arm"
    prompts = (f"a person raises {hand}", f"someone lifts {arm} up", f"the person puts {hand} up in the air")
    action = f"raise-up-{side}-hand" + ("s" if side == "both" else "")
    return Behaviour(f"raises {hand}", prompts, p.raises(side), action)


def _wave(side: str) -> Behaviour:
    """Describe waving the left hand, the right hand, or both."""
    hand = "both hands" if side == "both" else f"the {side} hand"
    prompts = (f"a person waves {hand}", f"someone is waving with {hand}", f"a man stands and waves {hand}")
    return Behaviour(f"waves {hand}", prompts, p.waves(side), f"wave-{side}-hand" + ("s" if side == "both" else ""))


def _turn(side: str) -> Behaviour:
    """Describe a walk that turns to one side."""
    prompts = (
        f"a person walks and turns {side}",
        f"someone is walking and makes a turn to the {side}",
        f"a man turns to the {side} while walking",
    )
    return Behaviour(f"turns {side}", prompts, p.turns(side), f"walk-turn-{side}")


ACTIONS = (
    Behaviour("walks", ("a person walks forward", "someone is walking", "a man walks straight ahead"),
              FORWARD, "walk"),
    Behaviour("runs", ("a person runs forward", "someone is running", "a man jogs straight ahead"),
              p.all_of(FORWARD, p.faster(1.6)), "run"),
    *(_turn(side) for side in ("left", "right")),
    *(_raise(side) for side in ("left", "right", "both")),
    *(_wave(side) for side in ("left", "right", "both")),
)  # fmt: skip

STYLES = (
    Behaviour("walks slowly when exhausted", ("an exhausted person walks", "someone walks forward, very tired"),
              p.all_of(FORWARD, p.slower(1.11)), "walk", "exhausted"),
    Behaviour("walks slowly when old", ("an old person walks forward", "someone walks like an elderly person"),
              p.all_of(FORWARD, p.slower(1.0)), "walk", "elderly"),
    Behaviour("walks fast when active", ("a person walks with a lot of energy", "someone walks energetically"),
              p.all_of(FORWARD, p.faster(1.27)), "walk", "active"),
    Behaviour("runs slowly when old", ("an old person runs", "someone is running like an elderly person"),
              p.all_of(FORWARD, p.faster(1.0), p.slower(2.0)), "run", "elderly"),
    Behaviour("runs fast when active", ("a person runs with a lot of energy", "someone runs energetically"),
              p.all_of(FORWARD, p.faster(2.9)), "run", "active"),
    Behaviour("stands with feet apart, masculine",
              ("a person raises both hands in a masculine way", "someone lifts both arms in a manly way"),
              lambda joints: p.ankle_gap(joints) > 0.21, "raise-up-both-hands", "masculine"),
    Behaviour("stands with feet together, feminine",
              ("a person raises both hands in a feminine way", "someone lifts both arms in a feminine manner"),
              lambda joints: p.ankle_gap(joints) < 0.125, "raise-up-both-hands", "feminine"),
    Behaviour("opens the arms wide, youthful",
              ("a person raises both hands in a youthful way", "someone lifts both arms like a young person"),
              lambda joints: p.wrist_gap(joints) > 0.68, "raise-up-both-hands", "youthful"),
)  # fmt: skip

RARE = (
    Behaviour("dashes", ("a person dashes forward", "someone sprints"), p.faster(2.5), "dash", gated=False),
    Behaviour("walks back", ("a person walks backward", "someone steps backwards"),
              p.goes(1, -1, 0.3), "walk-back", gated=False),
    Behaviour("walks to the left", ("a person walks sideways to the left", "someone walks leftward"),
              p.goes(0, 1, 0.3), "walk-left", gated=False),
    Behaviour("walks to the right", ("a person walks sideways to the right", "someone walks rightward"),
              p.goes(0, -1, 0.3), "walk-right", gated=False),
    Behaviour("bows", ("a person bows", "someone takes a bow"), p.bows, "bow", gated=False),
    Behaviour("waves goodbye", ("a person waves goodbye", "someone says goodbye"), p.waves_a_hand, "bye", gated=False),
    Behaviour("punches", ("a person punches", "someone throws punches"), p.punches, "punch", gated=False),
    Behaviour("kicks", ("a person kicks", "someone kicks with one leg"), p.kicks, "kick", gated=False),
)  # fmt: skip

BEHAVIOURS = ACTIONS + STYLES + RARE
