"""The corner tracks of a log by the links that they follow: the posture that
each image tells, the share that follows no link, and views for people.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..types import Array, PostureReadings
from .calibration import LEAST_RANGE

if TYPE_CHECKING:
    from ..kinematics.chain import Chain
    from ..kinematics.landmarks import LandmarkModel, LandmarkSightings
    from ..kinematics.links import Space
    from ..kinematics.robot import Robot

FOREIGN = -1
"""Number of the body of a piece that follows none."""
MOST_VIEWS = 6
"""Images of a camera that are shown to people."""
_MOST_CORNERS = 80
"""Corners that are shown in one image."""
_TRAIL_IMAGES = 10
"""Images that a drawn trail is long."""
_TOLD_SHARE = 0.5
"""Share of UNTOLD_STD above which images tell nothing of a joint."""


@dataclass(frozen=True, eq=False)
class LinkedTracks:
    """The corners that move before a camera, by the bodies
    that they follow, for given unknowns φ (P,) of the model.

    body (K,): numbers of the model's bodies, FOREIGN for none · places (K,3) m on them.
    """

    model: "LandmarkModel"
    phi: Array
    seen: "LandmarkSightings"
    body: Array
    places: Array

    @property
    def foreign_share(self) -> float:
        """The share of corners that follow neither the robot nor the scene."""
        return float((self.body == FOREIGN).mean())

    def summarise(self) -> tuple[list[str], int, dict[str, Any]]:
        """The links that bear corners, the number of images,
        and the corners as a candidate for a feature.
        """
        import numpy as np

        moving = self.on_moving_links
        links = [self.model.bodies[number].link for number in np.unique(self.body[moving])]
        images = np.unique(self.seen.t)
        row = {
            "kind": "surface",
            "seen": len(np.unique(self.seen.t[moving[self.seen.piece]])) / len(images),
            "strays_px": float(np.std(self.seen.uv[moving[self.seen.piece]], axis=0).mean()),
            "explained": 1.0 - self.foreign_share,
            "arm": True,
            "why_not": None,
            "line": "arm = { surface = true }",
        }
        return links, len(images), row

    @property
    def on_moving_links(self) -> Array:
        """Which pieces (K,) lie on links that move before the camera."""
        import numpy as np

        moving = np.array([len(one.chain.column) > 0 for one in self.model.bodies])
        return np.asarray((self.body != FOREIGN) & moving[self.body])


def link_tracks(model: "LandmarkModel", phi: Array, seen: "LandmarkSightings") -> LinkedTracks:
    """Each piece on the body that explains it, or on none."""
    import numpy as np

    from ..kinematics.landmark_adjustment import assign_pieces
    from ..kinematics.landmark_fit import THRESHOLDS_PX, explained_pieces

    chosen = assign_pieces(model, phi, seen)
    sound = (chosen.error < THRESHOLDS_PX[-1]) & explained_pieces(model, chosen)
    return LinkedTracks(model, phi, seen, np.where(sound, chosen.body, FOREIGN), chosen.places)


def describe_foreign(camera: str, share: float) -> str:
    """The share of foreign corners in words."""
    return (
        f"{camera}: {share:.0%} of the moving corners are foreign and left out: they follow neither "
        "a link nor the scene (people, held things, cloth, shadows, corners that slide)"
    )


def read_postures(
    linked: LinkedTracks, names: Sequence[str], start_ns: int, delay_std: float
) -> PostureReadings | None:
    """The posture that each image tells, by all corners on
    links that move; None without any.

    names (M,): the log's joints, in the order of the model's · start_ns: when the log begins ·
    delay_std (s): of the camera's delay. Of a joint at rest images tell nothing: where its corners
    are is known by its encoder alone.
    """
    import numpy as np

    from ..kinematics.landmark_adjustment import Landmarks, reduce_normal
    from ..kinematics.landmark_postures import UNTOLD_STD, posture_readings

    used = np.flatnonzero(linked.on_moving_links)
    if not len(used):
        return None
    seen = linked.seen.take(used)
    landmarks = Landmarks(linked.body[used], linked.places[used])
    reduced = reduce_normal(linked.model, linked.phi, seen, landmarks)
    t, angles, cov = posture_readings(
        linked.model, linked.phi, seen, landmarks, reduced.place_matrix
    )
    speed = linked.model.motions[0].at(t)[1]
    cov += delay_std**2 * speed[:, :, None] * speed[:, None]
    low, high = np.percentile(linked.model.motions[0].q, [2.0, 98.0], axis=0)
    resting = np.flatnonzero(high - low < LEAST_RANGE)
    cov[:, resting, resting] += UNTOLD_STD**2
    source = start_ns + np.rint(1e9 * np.unique(seen.t)).astype(np.int64)
    return PostureReadings(t, angles, cov, tuple(names), source)


def describe_postures(camera: str, found: PostureReadings) -> str:
    """How well images tell each joint, in words, and of which they tell nothing."""
    import numpy as np

    from ..kinematics.landmark_postures import UNTOLD_STD

    std = np.sqrt(np.median(np.einsum("nii->ni", found.cov), axis=0))
    shown = [
        f"{name} {1e3 * size:.2g}"
        for name, size in zip(found.names, std, strict=True)
        if size <= _TOLD_SHARE * UNTOLD_STD
    ]
    nothing = [
        name for name, size in zip(found.names, std, strict=True) if size > _TOLD_SHARE * UNTOLD_STD
    ]
    text = f"{camera}: {len(found.t)} images tell the posture, each to (mrad): {', '.join(shown)}"
    return text + (f"; nothing of {', '.join(nothing)}" if nothing else "")


def views_as_values(linked: LinkedTracks, space: "Space") -> dict[str, Any]:
    """What a person sees of one camera of a log, as plain values.

    foreign: share of the sightings · links: names of the bodies · images: of some images t (s), the
    skeleton's segments (S,4) px and the corners (k,5): u, v as measured and as predicted, and the
    number of the body.
    """
    import numpy as np

    own = linked.seen.take(np.flatnonzero(linked.body != FOREIGN))
    kept = linked.body != FOREIGN
    predicted = linked.model.predict(linked.phi, own, linked.body[kept], linked.places[kept]).image
    moving = linked.on_moving_links[kept][own.piece]
    instants, counts = np.unique(own.t[moving], return_counts=True)
    if not len(instants):
        return {"foreign": linked.foreign_share, "links": [], "images": []}
    chains = chains_to_links(linked, space)
    images = []
    # of each part of the film the image that shows most corners
    for part in np.array_split(np.arange(len(instants)), min(MOST_VIEWS, len(instants))):
        t = float(instants[part[np.argmax(counts[part])]])
        rows = np.flatnonzero((own.t == t) & moving)[:_MOST_CORNERS]
        corners = np.column_stack(
            [own.uv[rows], predicted[rows], linked.body[kept][own.piece[rows]]]
        )
        bones = skeleton_segments(linked, space.robot, chains, t)
        images.append(
            {"t": t, "bones": bones.round(1).tolist(), "corners": corners.round(2).tolist()}
        )
    links = [one.link for one in linked.model.bodies]
    return {"foreign": linked.foreign_share, "links": links, "images": images}


def trails_as_views(
    linked: LinkedTracks,
) -> "Iterator[tuple[float, Array, Array, tuple[tuple[int, Array], ...]]]":
    """Yield some images with the tracks in them, as where each corner came from: t (s), no bones
    (0,4), no corners (0,5), trails (link or FOREIGN, places (n,2) px).
    """
    import numpy as np

    seen = linked.seen
    instants = np.unique(seen.t)
    places = (np.arange(MOST_VIEWS) + 0.5) / MOST_VIEWS * len(instants)
    for number in np.unique(places.astype(int)):
        t = float(instants[number])
        since = float(instants[max(number - _TRAIL_IMAGES, 0)])
        trails = list[tuple[int, Array]]()
        for row in np.flatnonzero(seen.t == t):
            piece = int(seen.piece[row])
            own = np.flatnonzero((seen.piece == piece) & (seen.t >= since) & (seen.t <= t))
            trails.append((int(linked.body[piece]), seen.uv[own]))
        yield t, np.zeros((0, 4)), np.zeros((0, 5)), tuple(trails)


def chains_to_links(linked: LinkedTracks, space: "Space") -> "dict[str, Chain]":
    """The chain from the camera's link to each of the robot's."""
    camera = linked.model.rig.cameras[0].link
    return {link: space.chain(camera, link) for link in space.robot.links}


def skeleton_segments(
    linked: LinkedTracks, robot: "Robot", chains: "Mapping[str, Chain]", t: float
) -> Array:
    """Segments (S,4) px, u, v at both ends, that join the origins
    of the URDF's links in an image at t (s); those before the camera.
    """
    import numpy as np

    from ..kinematics.camera import project_points

    model = linked.model
    theta = model.changed(linked.phi)
    late = linked.phi[model.of_delays][0]
    angles = model.rig.angles(theta, model.motions[0].at(np.array([t - late]))[0])
    camera = model.rig.camera_pose(0, theta)
    places = dict[str, Array]()
    for link, chain in chains.items():
        inside = chain.at(angles).place[0]
        places[link] = camera[:3, :3] @ inside + camera[:3, 3]
    ends = [
        (places[joint.parent], places[link])
        for link, joint in robot.above.items()
        if min(places[joint.parent][2], places[link][2]) > 0.05
        and np.linalg.norm(places[joint.parent] - places[link]) > 1e-3
    ]
    if not ends:
        return np.zeros((0, 4))
    image, _, _ = project_points(np.array(ends).reshape(-1, 3), linked.phi[6:12])
    return np.asarray(image.reshape(-1, 4))
