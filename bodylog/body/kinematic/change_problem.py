"""Lay out what may have changed since a body was learned: its tracks in one log, and the unknowns
of joints, cameras, markers and a load.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...errors import InputError
from ...kinematics.hand import COMPLIANCE_SPREAD, Hand, find_hands, find_same_hand
from ...types import Array, Features
from ..data.pairs import NO_ERRORS, correlate_angle_errors, pair_sightings, smooth_all_joints
from ..data.subsampling import choose_spaced_rows
from ..gp.posed_gp import PosedGP
from .change_system import ChangePart, ChangeProblem, ChangeTrack, Sinking
from .model import can_show_changes

SLIP = np.radians(5.0)
SLIDE = 0.1
"""rad: prior std of a zero's change, and m per rad for
a prismatic joint; the default of `fit --offset-prior`.
"""
CAMERA = np.array([0.02] * 3 + [np.radians(2.0)] * 3)
"""m, rad: prior std of a camera's motion; that of
a camera placed by a transform (links.TF_POSE).
"""
MARKER = np.array([0.01] * 3 + [np.radians(5.0)] * 3)
"""m, rad: prior std of a marker's motion: its own size, and as far as a joint."""
LOAD = 0.02
"""rad: prior std of the largest sag under a load, along each direction, 1.1°."""
SCALES = (1.0, 0.2, 0.05)
"""Shares of these prior stds of poses and loads that are tried: a push has 2° or 0.1°, and six
numbers of a prior 20 times too wide cost 18 nats. Of 15 drawn pushes and payloads of 0.1 to 0.3°
the cause had most nats in 4 with the widest alone, and in all with these.
"""
PAYLOAD = "payload"
"""The name of a load among the things that explain a log."""
MOST = 200
FEWEST = 10
"""Most and fewest sightings of a track: few show a change, and the cost is O(n³)."""
_ONSETS = 8


def pose_problem(
    features: Features, body: BodyModel, lasting: Mapping[str, tuple[float, float]] = NO_ERRORS
) -> ChangeProblem | None:
    """Pose the linear problem of all changes; None where
    no track has kinematics, or a joint lacks readings.
    """
    senses = _list_posed_senses(features, body)
    names = () if features.joints is None else features.joints.names
    if not senses or not can_show_changes(body) or not set(body.joints) <= set(names):
        return None
    try:
        chosen = smooth_all_joints([features], body.joints, lasting)
    except InputError:
        return None  # an encoder with hardly any readings
    tracks = []
    for name, model in senses.items():
        part = pair_sightings([features], name, chosen, 1)
        part = part.rows(choose_spaced_rows(len(part.x), MOST)) if len(part.x) else part
        known = correlate_angle_errors(part, chosen)
        coupling = (known.i, known.j, known.joint, known.value)
        tracks.append(ChangeTrack(name, model, part, coupling, *model.name_poses(name)))
    tracks = [track for track in tracks if len(track.part.x)]
    if not tracks:
        return None
    laid = tracks if tracks[0].model.shares_unknowns else _number_unknowns(tracks)
    return _lay_out_problem(_hang_weights(laid), body.joints)


def _list_posed_senses(features: Features, body: BodyModel) -> dict[str, PosedGP]:
    """Models of this log's tracks whose camera can move: every track before it can follow."""
    seen = {name: model for name, model in body.senses.items() if name in features.tracks}
    fixed = {name.rpartition("/")[0] for name, one in seen.items() if not isinstance(one, PosedGP)}
    return {
        name: model
        for name, model in seen.items()
        if isinstance(model, PosedGP) and name.rpartition("/")[0] not in fixed
    }


def _number_unknowns(tracks: Sequence[ChangeTrack]) -> list[ChangeTrack]:
    """Tracks on found axes, with the places of their directions among those of all, and with
    their scales: tracks learned with one URDF share all directions, and lengths in m.
    """
    first = 0
    markers = dict[str, list[str]]()
    numbered = []
    for track in tracks:
        own = markers.setdefault(track.camera, [])
        if track.marker not in own:
            own.append(track.marker)
        scale = own.index(track.marker) if track.model.length_unit == "1" else 0
        numbered.append(replace(track, first=first, scale=scale))
        first = numbered[-1].unknown_directions.stop
    return numbered


def _hang_weights(tracks: Sequence[ChangeTrack]) -> list[ChangeTrack]:
    """Tracks with how they sink under a pull at each hand that the arm may hold."""
    every = np.concatenate([track.part.x for track in tracks])
    hands = find_hands([track.model for track in tracks], every)
    loads = [_sink_at_hand(hand, tracks) for hand in hands]
    return [
        replace(track, sinkings=tuple(load[number] for load in loads))
        for number, track in enumerate(tracks)
    ]


def _sink_at_hand(hand: Hand, tracks: Sequence[ChangeTrack]) -> list[Sinking]:
    """The levers of joints of each track's sightings, and of those that stood still.

    Of a hand of found axes nothing gives way here: it would look like a camera that was pushed, 1°
    of which had 610 nats as that and 613 as this.
    """
    levers = [hand.measure_levers(track.part.x) for track in tracks]
    ways = 1 if hand.is_upright else 3
    longest = max(float(np.abs(lever[..., :ways]).max()) for lever in levers)
    own = [find_same_hand(track.model, hand) if hand.is_upright else None for track in tracks]
    names = list(dict.fromkeys(name for one in own if one for name in one.still_joints))
    sinkings = []
    for track, lever, one in zip(tracks, levers, own, strict=True):
        joints = lever[..., :ways] / longest
        links = np.zeros_like(joints) if hand.is_upright else lever[..., ways:] / longest
        still = np.zeros((len(lever), len(names), ways))
        shown = np.zeros((len(lever), len(track.model.outputs), len(names)))
        if one:
            place = [names.index(name) for name in one.still_joints]
            shown[..., place], moves = one.show_still_joints(track.part.x)
            still[:, place] = moves / longest
        sinkings.append(Sinking(joints, links, still, shown))
    return sinkings


def _lay_out_problem(tracks: Sequence[ChangeTrack], names: tuple[str, ...]) -> ChangeProblem | None:
    first = tracks[0].model
    if first.knows_zeros:
        return None
    t = np.concatenate([track.part.t for track in tracks])
    inner = (
        np.quantile(t, np.arange(1, _ONSETS) / _ONSETS).tolist()
        if len(t) >= 2 * _ONSETS * len(names)
        else []
    )
    onsets = (-np.inf, *inner)
    parts = list[ChangePart]()
    std = list[Array]()

    def add_scaled_parts(kind: str, name: str, spread: Array) -> None:
        for scale in SCALES:
            add_part(kind, name, scale * spread)

    def add_part(
        kind: str,
        name: str,
        spread: Array,
        onset: float = -np.inf,
        unit: str = "rad",
        hand: int = 0,
    ) -> None:
        begin = sum(len(one) for one in std)
        parts.append(ChangePart(kind, name, slice(begin, begin + len(spread)), onset, unit, hand))
        std.append(spread)

    for m, name in enumerate(names):
        unit = "m" if first.slides(m) else "rad"
        factor = SLIDE if first.slides(m) else 1.0
        for onset in onsets:
            add_part("joint", name, np.array([SLIP * factor]), onset, unit)
    for camera in dict.fromkeys(track.camera for track in tracks):
        scales = max(track.scale for track in tracks if track.camera == camera)
        add_scaled_parts("camera", camera, np.concatenate([CAMERA, np.tile(CAMERA[:3], scales)]))
    for name, model in {track.marker: track.model for track in tracks}.items():
        add_scaled_parts("marker", name, MARKER[: model.marker_freedom])
    for hand, sinking in enumerate(tracks[0].sinkings):
        compliances = np.full(2 * len(names) + sinking.still.shape[1], COMPLIANCE_SPREAD)
        for scale in SCALES:
            pull = np.full(sinking.joints.shape[2], scale * LOAD)
            add_part("load", PAYLOAD, np.concatenate([pull, compliances]), hand=hand)
    kept = tuple(np.arange(len(track.part.x)) for track in tracks)
    return ChangeProblem(names, tuple(tracks), tuple(parts), np.concatenate(std), onsets, kept)
