"""E2, non-linear proprioception: encoders read the square of the angle; the belief starts wrong, one sign included.

The arm stands still for 5 s and then moves, as in the paper.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from ..body_model import BodyModel
from ..settings import Estimation
from ..types import Array
from . import drawn, readings
from .beliefs import Belief, believed, estimated
from .cases import Explored, Made, case, explored, signals, study
from .claims import Bound, Claim, Control
from .judging import own, paper
from .lab import NAMES, Lab, ObservedLog
from .printed import Case, Signals
from .readings import Reading
from .records import Experiment, Readings, Trial, by_reading, column, named, panel

START = (-0.8, 0.70, 0.60)
"""rad: the paper's prior, which has the wrong sign for shoulder 2."""
NEAR = 0.05
"""rad: a belief's size this close to the truth's has converged."""
BEGINS = 5.0
"""s when the arm starts moving."""
CONCERNED = ("sigma_n", "sigma_v", "integration", "lambda", "speed", "noise")
"""Constants that the claims may depend on; the prior is printed here."""


class _Logs:
    """The logs of one seed by speed, noise and the encoders' reading: squares or angles."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.made: dict[tuple[float, float, bool], tuple[ObservedLog, Signals]] = {}

    def both(self, reading: Reading, square: bool = True) -> tuple[ObservedLog, Signals]:
        period, noise = (readings.number(reading, name) for name in ("speed", "noise"))
        assert period is not None and noise is not None
        if (period, noise, square) not in self.made:
            observed = drawn.log(period, noise, self.seed, begins=BEGINS, square=square)
            self.made[period, noise, square] = observed, signals(observed)
        return self.made[period, noise, square]


def _run(lab: Lab, seed: int, tried: Readings) -> Trial:
    known, logs = explored(lab.body("paper", seed)), _Logs(seed)
    found = study(tried.all, lambda r: logs.both(r)[1], lambda r, s: {"p": _case(known, r, True)})
    plain = study(
        tried.all, lambda r: logs.both(r, False)[1], lambda r, s: {n: _case(known, r, False, n) for n in ("p", "p+v")}
    )
    figures: dict[str, float] = {}
    for reading in tried.all:
        key = readings.key(reading)
        figures |= {named(key, name): value for name, value in _figures(found[key], plain[key]).items()}
    observed = logs.both(tried.decide[0])[0]
    body = squared(lab.body("default", seed))
    beliefs = {"encoders": descended(observed, body, ("encoders",), START)[0], "vision": signed(observed, body)}
    figures |= {f"ours {name}": _largest(belief.x - belief.true) for name, belief in beliefs.items()}
    return {"figures": figures, "panels": _panels(found[tried.keys[0]], beliefs)}


def _case(known: Explored, reading: Reading, square: bool, senses: str = "p") -> Case:
    start = np.array(START) if square else np.array(START) * [1.0, -1.0, 1.0]
    return case(known, reading, senses, start, square=square)


def _figures(made: Made, plain: Made) -> dict[str, float]:
    t, x, true = made.signals.t, made.x["p"], made.signals.true
    still, moving = t < BEGINS, t >= BEGINS + drawn.SETTLING / 2
    return {
        "converged": converged(t[still], x[still], true[still]),
        "shoulder": float(abs(x[still][-20:, 1].mean() - abs(true[0, 1]))),
        "slower": _lag(made, "p", moving) / _lag(plain, "p+v", moving),
        "slower than p": _lag(made, "p", moving) / _lag(plain, "p", moving),
        "signed": float(abs(x[still][-20:, [0, 2]] - true[still][-20:, [0, 2]]).max()),
    }


def _lag(made: Made, senses: str, rows: Array) -> float:
    """Error (rad) of the angles' absolute values, which a square determines, while the arm moves."""
    return float(np.sqrt(np.mean((np.abs(made.x[senses]) - np.abs(made.signals.true))[rows] ** 2)))


def converged(t: Array, x: Array, true: Array) -> float:
    """Seconds until every joint's size stays within NEAR of the truth's; infinite if never, NaN if it diverged."""
    if np.isnan(x).any():
        return float("nan")
    beyond = np.flatnonzero(~(np.abs(np.abs(x) - np.abs(true)).max(axis=1) < NEAR))
    if not len(beyond):
        return 0.0
    return float(t[beyond[-1] + 1] - t[0]) if beyond[-1] + 1 < len(t) else float("inf")


@dataclass(frozen=True)
class Squared:
    """A forward model of M encoders that read x²."""

    outputs: tuple[str, ...]

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """At x (N,M) rad: x² · its Jacobian (N,M,M) · no model variance."""
        return x * x, 2.0 * x[:, :, None] * np.eye(x.shape[1]), np.zeros(x.shape)


def squared(body: BodyModel) -> BodyModel:
    """The body with encoders that read x²."""
    return replace(body, senses={**body.senses, "encoders": Squared(body.joints)})


def descended(
    observed: ObservedLog, body: BodyModel, senses: tuple[str, ...], start: tuple[float, ...]
) -> tuple[Belief, float]:
    """Our predictive coding from `start`, and its mean free energy (nats) while the arm stands still."""
    settings = Estimation(method="predictive-coding", senses=senses, start=start)
    found = estimated(observed, body, settings)
    rest = (found.joints.t >= BEGINS / 2) & (found.joints.t < BEGINS)
    return believed(found, observed), float(found.free_energy[rest].mean())


def signed(observed: ObservedLog, body: BodyModel) -> Belief:
    """The belief of least free energy, of those started at every choice of signs of the encoders' roots."""
    assert observed.features.joints is not None
    columns = [observed.features.joints.names.index(name) for name in body.joints]
    size = np.sqrt(np.abs(np.median(observed.features.joints.values[:100, columns], axis=0)))
    starts = [tuple((size * signs).tolist()) for signs in product((-1.0, 1.0), repeat=len(size))]
    tried = [descended(observed, body, ("encoders", "vision"), start) for start in starts]
    return min(tried, key=lambda pair: pair[1])[0]


def _largest(error: Array) -> float:
    """Largest joint's mean absolute error (rad) over the second half of the log."""
    return float(np.abs(error[len(error) // 2 :]).mean(axis=0).max())


def _panels(made: Made, beliefs: dict[str, Belief]) -> list[dict[str, Any]]:
    t, x, true = made.signals.t, made.x["p"], made.signals.true
    panels = []
    for i, name in enumerate(NAMES):
        lines = {
            "printed": x[:, i] ** 2,
            "ours with vision": beliefs["vision"].at(t)[:, i] ** 2,
            "truth": true[:, i] ** 2,
        }
        panels.append(panel(f"{name}, what its encoder reads", "rad²", t, lines, "5a"))
    lines = {"printed": x[:, 1], "ours with vision": beliefs["vision"].at(t)[:, 1], "truth": true[:, 1]}
    return [*panels, panel("shoulder 2, the angle", "rad", t, lines, "5a")]


def _claims(trials: Sequence[Trial], tried: Readings) -> tuple[Claim, ...]:
    figures = by_reading(trials)
    close = Control("error of the joints whose sign was right", "rad", Bound("≤", NEAR), "signed")
    still = tried.restricted("integration", "lambda", "noise")
    alone = np.median(figures(tried.keys[0], "slower than p"))
    slower = f"over that of p alone it is {alone:.2f}: the slope of x² is 2x, above 1 where |x| > ½ rad"
    rows: tuple[tuple[str, str, str, Bound, str, Readings, tuple[Control, ...], str], ...] = (
        ("the belief converges in the first 5 s", "seconds until within 0.05 rad", "s", Bound("≤", BEGINS),
         "converged", still, (), ""),
        ("squares hide the sign: shoulder 2 settles at +0.869, the truth being −0.869",
         "distance from +0.869 after 5 s", "rad", Bound("≤", NEAR), "shoulder", still, (close,), ""),
        ("the reaction is slower than in the previous experiment, which had p+v",
         "error while moving over that of p+v with encoders that read angles", "1", Bound("≥", 1.0),
         "slower", tried, (), slower),
    )  # fmt: skip
    papers = (
        paper(f"E2.{k}", text, measured, unit, bound, figure, figures, part.keys, part.swept, controls, why)
        for k, (text, measured, unit, bound, figure, part, controls, why) in enumerate(rows, 1)
    )
    return (*papers, *_own_claims(trials))


def _own_claims(trials: Sequence[Trial]) -> Iterator[Claim]:
    error = "largest joint's mean error", "rad"
    yield own("E2.4", "our predictive coding on encoders alone does not find the sign either", *error,
              Bound("≥", 1.0), column(trials, "ours encoders"))  # fmt: skip
    yield own("E2.5", "vision gives the sign: only one root explains the image", *error,
              Bound("≤", NEAR), column(trials, "ours vision"),
              "of the eight choices of sign the one of least free energy is taken")  # fmt: skip


EXPERIMENT = Experiment("E2", "Non-linear proprioception", _run, _claims, CONCERNED)
