"""A body learned from pictures dated as the encoders are: the body itself tells how late a camera was."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from .settings import Settings
from .types import BodyModel, Features, Finding

if TYPE_CHECKING:
    from .body.learning import Learned
    from .estimation.delay import Delay

TURNS = 6
"""Bodies learned at most, each from pictures dated by what the last one told."""
ALIKE = 4.0
"""Standard errors within which a log that does not tell may be as late as one that does."""

Delays = Mapping[str, float]


def learned(
    features: Sequence[Features], settings: Settings, provenance: Mapping[str, Any], known: BodyModel | None
) -> "Learned":
    """`body.learn` of features whose cameras' delays, as given or as each log tells them, are taken off, and said.

    A body takes part of a delay for the arm's shape, and the like part of what is left then: steps are lengthened by
    that. The body keeps the delays of the logs that are surest of theirs. UsageError for a name that is no camera's.
    """
    from . import body
    from .estimation import dating

    fixed = dating.named(settings.time.delay, dating.cameras([name for f in features for name in f.tracks]))
    late, own, last = [dict(fixed) for _ in features], {k: v for k, v in fixed.items() if v}, dict[str, float]()
    for turn in range(TURNS):
        timely = [dating.earlier(found, delays) for found, delays in zip(features, late, strict=True)]
        found = body.learn(timely, settings, {**provenance, **({"delay": own} if own else {})}, known)
        rests = [_late(one, found.model, known) for one in timely]
        surest = dict(_surest(rests, fixed, last))
        if not surest or turn == TURNS - 1:
            break
        for name, at in surest.items():
            step = rests[at][name].seconds
            share = step / last[name] if name in last else 0.0
            last[name] = step
            for delays, rest in zip(late, rests, strict=True):
                more = _own(rest.get(name), rests[at][name]) / (1.0 - share if 0.0 < share < 0.5 else 1.0)
                delays[name] = round(delays.get(name, 0.0) + more, 6)
            own[name] = late[at][name]
    said = [
        Finding(f.severity, f"log {k + 1}: {f.text}" if len(late) > 1 else f.text)
        for k, (delays, rest) in enumerate(zip(late, rests, strict=True))
        for f in dating.told(delays, rest, fixed)
    ]
    return replace(found, findings=(*said, *found.findings))


def _late(timely: Features, model: BodyModel, known: BodyModel | None) -> dict[str, "Delay"]:
    """How late each camera still is by a body learned with it."""
    from .body import encoders
    from .estimation import dating

    tracks = {name: sense for name, sense in model.senses.items() if name != "encoders"}
    return dating.late(encoders.referred(timely, known), replace(model, senses=tracks))


def _surest(
    rests: Sequence[Mapping[str, "Delay"]], fixed: Delays, begun: Delays
) -> Iterator[tuple[str, int]]:
    """Each camera that some log tells to be late, if but little once that has `begun`, with the log surest of it."""
    from .estimation import dating

    for name in sorted({name for rest in rests for name in rest} - set(fixed)):
        least = 0.0 if name in begun else dating.LEAST
        telling = [k for k, rest in enumerate(rests) if name in rest and dating.telling(rest[name], least)]
        if telling:
            yield name, min(telling, key=lambda k: rests[k][name].std_error)


def _own(rest: "Delay | None", surest: "Delay") -> float:
    """A log's own step (s); that of the surest where the log does not tell and may be as late."""
    from .estimation import dating

    if rest is None or (
        not dating.telling(rest) and abs(rest.seconds - surest.seconds) < ALIKE * (rest.std_error + surest.std_error)
    ):
        return surest.seconds
    return rest.seconds if dating.telling(rest) else 0.0
