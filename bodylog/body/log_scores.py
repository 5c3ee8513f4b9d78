"""Score a body on test logs: prediction errors of
each track, and the coverage of its error bars.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from ..body_model import BodyModel
from ..errors import EvidenceError, ModelError
from ..sources import group_of
from ..types import TRACK_AXES, Array, Features, Finding, Score
from .data.pairs import Pairs, drop_impossible_values, pair_sightings, smooth_all_joints
from .senses import encoder_function

COVERED = 2.0
"""Standard deviations within which 95 % of sightings should lie."""


def score_body_on_tests(
    model: BodyModel, features: Sequence[Features]
) -> tuple[tuple[Score, ...], tuple[Finding, ...]]:
    """Scores test_…/TRACK of all logs together, and of a
    board's tracks together; remarks on tracks not scored.

    Angles are the encoders', smoothed along a motion. EvidenceError where no log shows a track of
    the body's, ModelError where one lacks its joints.
    """
    features, findings = drop_impossible_values(
        [encoder_function.with_true_angles(found, model) for found in features]
    )
    for index, found in enumerate(features):
        names = () if found.joints is None else found.joints.names
        if missing := [name for name in model.joints if name not in names]:
            have = ", ".join(names) or "none"
            raise ModelError(
                f"test log {index + 1}: joint {missing[0]!r} of the body is not there; it "
                f"has {have}"
            )
    chosen = smooth_all_joints(features, model.joints)
    seen = sorted({name for found in features for name in found.tracks} & set(model.senses))
    parts = {name: pair_sightings(features, name, chosen, 1) for name in seen}
    scored = {name: part for name, part in parts.items() if len(part.x)}
    if not scored:
        shown = ", ".join(sorted({name for found in features for name in found.tracks})) or "none"
        raise EvidenceError(
            f"test: no sighting of {', '.join(model.senses)}; tracks: {shown}; give another log"
        )
    unseen = [name for name in model.senses if name not in scored and name != "encoders"]
    findings += [
        Finding("warning", f"{name}: not scored, the test logs do not show it") for name in unseen
    ]
    errors = {name: _prediction_errors(name, part, model) for name, part in scored.items()}
    groups: dict[str, list[str]] = {}
    for name in errors:
        groups.setdefault(group_of(name), []).append(name)
    boards = {
        group: [errors[name] for name in names] for group, names in groups.items() if len(names) > 1
    }
    joint = {
        group: tuple(np.concatenate(column) for column in zip(*of, strict=True))
        for group, of in boards.items()
    }
    return tuple(
        s for name, one in {**joint, **errors}.items() for s in _scores_of_errors(name, *one)
    ), tuple(findings)


def _prediction_errors(name: str, part: Pairs, model: BodyModel) -> tuple[Array, Array]:
    """Errors (N,D) of one track and their predicted variances (N,D)."""
    mean, jac, var = model.senses[name].predict(part.x)
    return part.y - mean, var + _sighting_variance(name, part, model) + np.einsum(
        "ndm,nm->nd", jac**2, part.variance
    )


def _scores_of_errors(name: str, error: Array, total: Array) -> Iterator[Score]:
    """Yield scores of errors (N,D), px or mm, per axis and
    together, and their agreement with the variances.
    """
    ratio = error**2 / total
    size = np.linalg.norm(error, axis=1)
    axes, unit = TRACK_AXES[error.shape[1]]
    yield Score(f"rmse/test/{name}", float(np.sqrt(np.mean(size**2))), unit)
    for axis, own in zip(axes, error.T, strict=True):
        yield Score(f"rmse/test_{axis}/{name}", float(np.sqrt(np.mean(own**2))), unit)
    yield Score(f"median_error/test/{name}", float(np.median(size)), unit)
    yield Score(f"nis/test/{name}", float(ratio.mean()), "1")
    yield Score(f"coverage_2sigma/test/{name}", float((ratio <= COVERED**2).mean() * 100.0), "%")
    yield Score(f"sightings/test/{name}", float(len(error)), "images")


def _sighting_variance(name: str, part: Pairs, model: BodyModel) -> Array:
    """Variance (N,D) of sightings: stated std squared
    plus the learned excess, or else the learned one.
    """
    fallback = np.broadcast_to(model.noise.senses.get(name, (1.0,)), part.floor.shape)
    beyond = np.asarray(getattr(model.senses[name], "noise", 0.0))
    return np.where(part.floor > 0.0, part.floor + beyond, fallback)
