"""Update a body learned with a URDF: its chain, links and earlier samples stay."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...kinematics.calibration import refine_calibration
from ...kinematics.links import FoundLinks
from ...kinematics.rig import Carrier, Rig, RigCamera, Sight
from ...runtime.blas_threads import one_thread
from ...settings import Settings
from ...types import Array, Features
from ..data.pairs import join_pairs, pair_sightings, pairs_of_samples
from ..data.subsampling import choose_farthest_rows
from ..gp.model import GP
from ..learning import LearnedBody
from . import learn as kinematic
from .adjusting import Surroundings, recorded_logs
from .model import KinematicGP
from .sightings import ThingSightings


def senses_with_chain(body: BodyModel | None) -> dict[str, KinematicGP]:
    """The senses of a body with a kinematic chain."""
    senses = {} if body is None else body.senses
    return {name: sense for name, sense in senses.items() if isinstance(sense, KinematicGP)}


@one_thread("scipy.linalg")
def update_kinematics(
    features: Sequence[Features], settings: Settings, found: LearnedBody, update: BodyModel
) -> LearnedBody:
    """Add the chain of `update` to a body learned without it, where it still fits.

    The samples of `update` count as one more log. Unchanged,
    with a remark, where kinematics no longer fits.
    """
    known = {
        name: sense
        for name, sense in senses_with_chain(update).items()
        if isinstance(found.model.senses.get(name), GP)
    }
    if not known:
        return found
    parts = {}
    for name, sense in known.items():
        seen = any(name in one.tracks for one in features)
        new = [pair_sightings(features, name, found.joints, settings.fit.every)] if seen else []
        part = join_pairs([*new, pairs_of_samples(sense.samples, sense.targets, sense.spread)])
        part = part.rows(choose_farthest_rows(part.x, settings.fit.samples))
        parts[name] = ThingSightings(
            part, part.y[:, None], part.floor[:, None], sense.rig.sights[0].points, (name,)
        )
    rig, theta = _merge_rigs(known)
    data = [one.sighted for one in parts.values()]
    links = FoundLinks(refine_calibration(rig, data, theta), None, ())
    why = next((why for _, why in kinematic.find_unexplained_tracks(links, parts)), None)
    if why is not None:
        return kinematic.leave_urdf_unused(
            found, why, "learn a new body where the camera was moved"
        )
    plain = {name: gp for name, gp in found.model.senses.items() if isinstance(gp, GP)}
    beside = Surroundings(recorded_logs(features))
    learned = kinematic.learn_residuals(found, links, parts, plain, settings.fit.seed, beside)
    model = _restore_bases(learned.model, known)
    # a few points stand for all of a board
    apart = {
        track for one in features for tracks, _ in one.boards.values() for track in tracks
    } | set(found.poor)
    kept = {
        name: s
        for name, s in model.senses.items()
        if name not in apart or isinstance(s, KinematicGP)
    }
    return replace(learned, model=replace(model, senses=kept))


def _merge_rigs(senses: Mapping[str, KinematicGP]) -> tuple[Rig, Array]:
    """The rig with one sight of each sense, and its θ (P,)."""
    cameras = dict[str, tuple[RigCamera, Array]]()
    carriers = dict[str, tuple[Carrier, Array]]()
    sights = list[Sight]()
    for sense in senses.values():
        camera = sense.rig.cameras[0]
        carrier = sense.rig.carriers[0]
        cameras.setdefault(camera.name, (camera, sense.theta[sense.rig.of_camera(0)]))
        carriers.setdefault(carrier.name, (carrier, sense.theta[sense.rig.of_carrier(0)]))
        places = list(cameras).index(camera.name), list(carriers).index(carrier.name)
        sights.append(replace(sense.rig.sights[0], camera=places[0], carrier=places[1]))
    first = next(iter(senses.values()))
    seen_by = tuple(one for one, _ in cameras.values())
    seen = tuple(one for one, _ in carriers.values())
    rig = replace(first.rig, cameras=seen_by, carriers=seen, sights=tuple(sights))
    parts = [*(theta for _, theta in cameras.values()), *(theta for _, theta in carriers.values())]
    return rig, np.concatenate([*parts, first.theta[first.rig.of_joints.start :]])


def _restore_bases(model: BodyModel, known: Mapping[str, KinematicGP]) -> BodyModel:
    """The model with the known senses' bases restored."""
    senses = {
        name: replace(sense, base=known[name].base)
        if isinstance(sense, KinematicGP) and name in known
        else sense
        for name, sense in model.senses.items()
    }
    return replace(model, senses=senses)
