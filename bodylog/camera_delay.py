"""A body learned from pictures dated as the encoders are: the body itself tells how late a camera was."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import TYPE_CHECKING, Any

from .body_model import BodyModel, ForwardModel
from .settings import Settings
from .types import Array, Features, Finding

if TYPE_CHECKING:
    from .body.kinematic.learn import Robotics
    from .body.learning import Learned
    from .estimation.timing.gp_likelihood import Prior
    from .estimation.timing.regression import Delay

TURNS = 5
"""Bodies learned at most, each from pictures dated by what the last one told."""
ALIKE = 4.0
"""Standard errors within which a log that does not tell may be as late as one that does."""
BETTER = 0.95
"""Of its error on withheld places a body must not keep more, or what it told of a delay was the arm's shape."""

Delays = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class _Turn:
    """A body learned of logs that were each so `late`, how late they still are by it, and what it keeps of all that."""

    found: "Learned"
    late: Sequence[Delays]
    rests: "Sequence[Mapping[str, Delay]]"
    own: Delays


def learned(
    features: Sequence[Features],
    settings: Settings,
    provenance: Mapping[str, Any],
    known: BodyModel | None,
    robot: "Robotics | None" = None,
) -> "Learned":
    """`body.learn` of features whose cameras' delays, as given or as each log tells them, are taken off, and said.

    The body keeps the delays of the logs that are surest of theirs. UsageError for a name that is no camera's.
    """
    from . import body
    from .estimation.timing import correction

    def turned(late: Sequence[Delays], own: Delays) -> _Turn:
        timely = [correction.shifted(found, delays) for found, delays in zip(features, late, strict=True)]
        told = {**provenance, **({"delay": dict(own)} if own else {})}
        found = body.learn(timely, settings, told, known, robot is not None)
        sure = replace(found.model, senses={n: s for n, s in found.model.senses.items() if n not in found.poor})
        return _Turn(found, late, [_late(one, sure, known) for one in timely], own)

    if all(found.poses for found in features):
        found = body.learn(features, settings, provenance, known, robot is not None)
        return body.with_kinematics(features, settings, found, robot, known)
    cameras = correction.cameras([name for found in features for name in found.tracks])
    fixed = correction.fixed_delays(settings.time.delay, cameras)
    own = {} if known is None else {k: v for k, v in correction.learned_delays(known).items() if k not in fixed}
    begun, given = set[str](), {name: delay for name, delay in fixed.items() if delay}
    turn = turned([{**own, **fixed} for _ in features], {**own, **given})
    for _ in range(TURNS - 1):
        surest = _surest(turn.rests, fixed, begun)
        if not surest:
            break
        after, least = turned(*_stepped(turn, surest)), BETTER if set(surest) - begun else 1.0
        if _missed(after, surest) > least * _missed(turn, surest):
            break
        turn, begun = after, begun | set(surest)
    timely = [correction.shifted(found, delays) for found, delays in zip(features, turn.late, strict=True)]
    found = body.with_kinematics(timely, settings, turn.found, robot, known)
    return replace(found, findings=(*_said(turn, fixed, begun), *found.findings))


def _said(turn: _Turn, fixed: Delays, begun: set[str]) -> Iterator[Finding]:
    """What was taken off each log's pictures, where any was, and what the log has against what is `fixed`."""
    from .estimation.timing import correction

    for k, (delays, rest) in enumerate(zip(turn.late, turn.rests, strict=True)):
        sure = {name: rest[name].std_error for name in begun if name in rest}
        for said in correction.delay_findings(delays, sure, rest, fixed):
            yield replace(said, text=f"log {k + 1}: {said.text}") if len(turn.late) > 1 else said


def _stepped(turn: _Turn, surest: Mapping[str, int]) -> tuple[Sequence[Delays], Delays]:
    """What each log is late by, and what the body keeps, with what this turn's body tells."""
    late = [dict(delays) for delays in turn.late]
    for name, at in surest.items():
        for delays, rest in zip(late, turn.rests, strict=True):
            delays[name] = round(delays.get(name, 0.0) + _own(rest.get(name), turn.rests[at][name]), 6)
    return late, {**turn.own, **{name: late[at][name] for name, at in surest.items()}}


def _missed(turn: _Turn, cameras: Iterable[str]) -> float:
    """Root mean square (px) of what the body misses on withheld places of some cameras' tracks, all together."""
    from .estimation.measurements.gather import camera

    kinds = (score.name.partition("rmse/held_out/") for score in turn.found.scores)
    seen = [found and camera(track) in cameras for _, found, track in kinds]
    return sqrt(sum(score.value**2 for score, counts in zip(turn.found.scores, seen, strict=True) if counts))


def _late(timely: Features, model: BodyModel, known: BodyModel | None) -> dict[str, "Delay"]:
    """How late each camera still is by a body learned with it."""
    from .body.senses import encoder_function
    from .estimation.timing import correction, gp_likelihood

    tracks = {name: sense for name, sense in model.senses.items() if name != "encoders"}
    told, seen = correction.sound_measurements(encoder_function.referred(timely, known), replace(model, senses=tracks))
    if told is None:
        return {}
    found = {
        name: gp_likelihood.measured(told, some, [_prior(one.model) for one in some]) for name, some in seen.items()
    }
    return {name: delay for name, delay in found.items() if delay is not None}


def _prior(model: ForwardModel) -> "Prior":
    """What a learned Gaussian process held likely before it learned."""
    import numpy as np

    from .body.gp.model import GP, se

    assert isinstance(model, GP)

    def prior(x: Array) -> tuple[Array, Array]:
        groups = zip(model.scales, model.amplitude, strict=True)
        kernels = [se(x / scales, x / scales, amplitude) for scales, amplitude in groups]
        outputs = range(len(model.mean))
        return model.mean, np.stack([model.share[d] * kernels[d if len(kernels) > 1 else 0] for d in outputs])

    return prior


def _surest(rests: Sequence[Mapping[str, "Delay"]], fixed: Delays, begun: set[str]) -> dict[str, int]:
    """Each camera that some log tells to be late, if but little once that has `begun`, with the log surest of it."""
    from .estimation.timing import correction

    found = {}
    for name in sorted({name for rest in rests for name in rest} - set(fixed)):
        least = 0.0 if name in begun else correction.LEAST
        if telling := [k for k, rest in enumerate(rests) if name in rest and correction.significant(rest[name], least)]:
            found[name] = min(telling, key=lambda k: rests[k][name].std_error)
    return found


def _own(rest: "Delay | None", surest: "Delay") -> float:
    """A log's own step (s); that of the surest where the log does not tell and may be as late."""
    from .estimation.timing import correction

    if rest is not None and correction.significant(rest):
        return rest.seconds
    if rest is None or abs(rest.seconds - surest.seconds) < ALIKE * (rest.std_error + surest.std_error):
        return surest.seconds
    return 0.0
