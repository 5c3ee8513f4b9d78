"""What moved between logs, in a sentence each."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...kinematics.rig import Rig
from ...types import Array, Finding
from ...wording import list_in_words
from .moves import CentreDisplacement, Move, RigThing, measure_displacement


def move_findings(
    rig: Rig, theta: Array, covariance: Array, moves: Sequence[Move], centres: Sequence[Array]
) -> Iterator[Finding]:
    """Yield a warning for each thing that moved, for θ (P,) ± covariance (P,P).

    centres: of each sight's points (3,) m, in the marker.
    """
    for move in moves:
        for thing in move.things:
            shown = [
                k
                for k, one in enumerate(rig.sights)
                if thing.kind == "marker" and one.carrier == thing.index
            ]
            centre = centres[shown[0]] if shown else np.zeros(3)
            moved = measure_displacement(rig, theta, covariance, thing, move.log, centre)
            others = [
                " and ".join(_thing_name(rig, one) for one in things)
                for things in move.alternatives
            ]
            doubt = (
                f"; the logs cannot tell it from a move of {list_in_words(others)}"
                if others
                else ""
            )
            before = f"log {move.log}" if move.log == 1 else f"logs 1 to {move.log}"
            kept = (
                f"it has a placement of its own in {before}, and the body holds the one since "
                f"log {move.log + 1}"
            )
            text = (
                f"{moved.name} moved between log {move.log} and log {move.log + 1}, by "
                f"{shown_move(moved)}"
            )
            yield Finding("warning", f"{text}: {kept} ({move.nats:.0f} nats likelier){doubt}")


def _thing_name(rig: Rig, thing: RigThing) -> str:
    return (rig.cameras if thing.kind == "camera" else rig.carriers)[thing.index].name


def shown_move(moved: CentreDisplacement) -> str:
    """A displacement in mm and degrees."""
    shift = f"{1e3 * moved.shift:.1f} ± {1e3 * moved.shift_std:.1f} mm"
    if moved.turn is None or moved.turn_std is None:
        return shift
    return f"{shift} and {np.degrees(moved.turn):.2f} ± {np.degrees(moved.turn_std):.2f}°"
