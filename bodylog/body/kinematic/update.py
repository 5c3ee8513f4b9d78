"""Update a body learned with a URDF: its chain, links and earlier samples stay."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...kinematics.calibration import refine
from ...kinematics.links import Found
from ...kinematics.rig import Camera, Carrier, Rig, Sight
from ...runtime.blas_threads import one_thread
from ...settings import Settings
from ...types import Array, Features
from ..data.pairs import joined, pairs, pairs_of_samples
from ..data.subsampling import farthest
from ..gp.model import GP
from ..learning import Learned
from . import learn as kinematic
from .adjusting import Surroundings, recorded_logs
from .model import KinematicGP
from .sightings import Sightings


def chained(body: BodyModel | None) -> dict[str, KinematicGP]:
    """The senses of a body with a kinematic chain."""
    senses = {} if body is None else body.senses
    return {name: sense for name, sense in senses.items() if isinstance(sense, KinematicGP)}


@one_thread("scipy.linalg")
def learn(features: Sequence[Features], settings: Settings, found: Learned, update: BodyModel) -> Learned:
    """Add the chain of `update` to a body learned without it, where it still fits.

    The samples of `update` count as one more log. Unchanged, with a remark, where kinematics no longer fits.
    """
    known = {name: sense for name, sense in chained(update).items() if isinstance(found.model.senses.get(name), GP)}
    if not known:
        return found
    parts = {}
    for name, sense in known.items():
        seen = any(name in one.tracks for one in features)
        new = [pairs(features, name, found.joints, settings.fit.every)] if seen else []
        part = joined([*new, pairs_of_samples(sense.samples, sense.targets, sense.spread)])
        part = part.rows(farthest(part.x, settings.fit.samples))
        parts[name] = Sightings(part, part.y[:, None], part.floor[:, None], sense.rig.sights[0].points, (name,))
    rig, theta = _whole(known)
    data = [one.sighted for one in parts.values()]
    links = Found(refine(rig, data, theta), None, ())
    why = next((why for _, why in kinematic.unexplained(links, parts)), None)
    if why is not None:
        return kinematic.unused(found, why, "learn a new body where the camera was moved")
    plain = {name: gp for name, gp in found.model.senses.items() if isinstance(gp, GP)}
    beside = Surroundings(recorded_logs(features))
    learned = kinematic.learned(found, links, parts, plain, settings.fit.seed, beside)
    model = _based(learned.model, known)
    # a few points stand for all of a board
    apart = {track for one in features for tracks, _ in one.boards.values() for track in tracks} | set(found.poor)
    kept = {name: s for name, s in model.senses.items() if name not in apart or isinstance(s, KinematicGP)}
    return replace(learned, model=replace(model, senses=kept))


def _whole(senses: Mapping[str, KinematicGP]) -> tuple[Rig, Array]:
    """The rig with one sight of each sense, and its θ (P,)."""
    cameras, carriers, sights = dict[str, tuple[Camera, Array]](), dict[str, tuple[Carrier, Array]](), list[Sight]()
    for sense in senses.values():
        camera, carrier = sense.rig.cameras[0], sense.rig.carriers[0]
        cameras.setdefault(camera.name, (camera, sense.theta[sense.rig.of_camera(0)]))
        carriers.setdefault(carrier.name, (carrier, sense.theta[sense.rig.of_carrier(0)]))
        places = list(cameras).index(camera.name), list(carriers).index(carrier.name)
        sights.append(replace(sense.rig.sights[0], camera=places[0], carrier=places[1]))
    first = next(iter(senses.values()))
    seen_by, seen = tuple(one for one, _ in cameras.values()), tuple(one for one, _ in carriers.values())
    rig = replace(first.rig, cameras=seen_by, carriers=seen, sights=tuple(sights))
    parts = [*(theta for _, theta in cameras.values()), *(theta for _, theta in carriers.values())]
    return rig, np.concatenate([*parts, first.theta[first.rig.of_joints.start :]])


def _based(model: BodyModel, known: Mapping[str, KinematicGP]) -> BodyModel:
    """The model with the known senses' bases restored."""
    senses = {
        name: replace(sense, base=known[name].base) if isinstance(sense, KinematicGP) and name in known else sense
        for name, sense in model.senses.items()
    }
    return replace(model, senses=senses)
