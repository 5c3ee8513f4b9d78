"""Sightings of one rigid thing by one camera, by image: a point,
or the points of a board together; or of a point by a tracker.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...kinematics.calibration import Sighted
from ...types import Array, Features, Series
from ..data.pairs import Pairs, SmoothedJoint, pair_sightings
from ..data.subsampling import choose_farthest_rows

GROUPS = 4
"""Most parts of a board; points of a part are averaged, since their errors are correlated."""
FEWEST = 3
"""Fewest points that determine a pose."""
REACH = 2.0
"""Length scale of residuals over a board in its diagonals,
per rad of a joint: they change by a third along one.
"""
PICTURES = 300
"""Most images of a board; more do not improve the residual process."""
_SOUND = 0.5
_POINT = np.zeros((1, 3))


@dataclass(frozen=True, eq=False)
class ThingSightings:
    """N images: angles and times, `whole`, with y the
    points' mean, px · image (N,C,2) px, floor (N,C,2) px²;
    of a point in space (N,1,3), mm and mm².

    NaN where a point was not seen · points (C,3) m on
    the thing · tracks: the points' tracks, in order.
    """

    whole: Pairs
    image: Array
    floor: Array
    points: Array
    tracks: tuple[str, ...]

    def rows(self, chosen: Array) -> "ThingSightings":
        """Return some images."""
        return replace(
            self, whole=self.whole.rows(chosen), image=self.image[chosen], floor=self.floor[chosen]
        )

    @property
    def seen(self) -> Array:
        """Which points were seen (N,C)."""
        return self.sighted.seen

    @property
    def sighted(self) -> Sighted:
        """The sightings for calibration."""
        return Sighted(self.whole.x, self.image, self.floor)


@dataclass(frozen=True, eq=False)
class PointMeans:
    """Rows that are means of some points of one image:
    picture (n,) of N · share (n,C) of each point.

    q (N,M) rad or m · log (N,) of each image · where (C,2): the points on their board, in REACH of
    its diagonal; (C,0) of a single point · further (N,K): readings of joints that stood still,
    where their zeros are unknowns.
    """

    q: Array
    log: Array
    where: Array
    picture: Array
    share: Array
    further: Array | None = None

    @property
    def x(self) -> Array:
        """Inputs (n,M) or (n,M+2) of the residual
        process: angles, and the position on the board.
        """
        return np.concatenate([self.q[self.picture], self.share @ self.where], axis=1)

    @property
    def readings(self) -> Array:
        """Readings (N,M+K) of all joints of each image."""
        return self.q if self.further is None else np.concatenate([self.q, self.further], axis=1)

    def of(self, values: Array) -> Array:
        """Values (n,…) of the rows from values of all points (N,C,…)."""
        if self.share.shape[1] == 1:
            return np.asarray(values[self.picture, 0])
        flat = values.reshape(*values.shape[:2], -1)
        return np.asarray(
            (self.share[:, None] @ flat[self.picture])[:, 0].reshape(-1, *values.shape[2:])
        )


def gather_sightings(
    features: Sequence[Features],
    tracks: Sequence[str],
    joints: Sequence[SmoothedJoint],
    every: int,
    most: int,
) -> dict[str, ThingSightings]:
    """Collect sightings by name, of boards with FEWEST points
    or more and of other tracks; at most `most` of each.
    """
    found = dict[str, ThingSightings]()
    taken = set[str]()
    for name, points in _points_by_board(features).items():
        taken |= set(points)
        if (board := _board_sightings(features, name, points, joints, every)) is not None:
            found[name] = board
    for track in tracks:
        if track not in taken:
            part = pair_sightings(features, track, joints, every)
            found[track] = ThingSightings(
                part, part.y[:, None], part.floor[:, None], _POINT, (track,)
            )
    least = {
        name: min(most, PICTURES) if len(one.points) > 1 else most for name, one in found.items()
    }
    return {
        name: one.rows(choose_farthest_rows(one.whole.x, least[name]))
        for name, one in found.items()
    }


def _points_by_board(features: Sequence[Features]) -> dict[str, dict[str, Array]]:
    """The points of each board by track, over all logs."""
    found: dict[str, dict[str, Array]] = {}
    for name, (tracks, points) in (item for one in features for item in one.boards.items()):
        found.setdefault(name, {}).update(zip(tracks, points, strict=True))
    return {name: points for name, points in found.items() if len(points) >= FEWEST}


def _board_sightings(
    features: Sequence[Features],
    name: str,
    points: Mapping[str, Array],
    joints: Sequence[SmoothedJoint],
    every: int,
) -> ThingSightings | None:
    shown = [_images_of_board(one, list(points)) for one in features]
    middles = [
        replace(
            one,
            tracks={
                name: Series(
                    t, _mean_of_points(image), ("u", "v"), "px", (t * 1e9).astype(np.int64)
                )
            },
        )
        for one, (t, image, _) in zip(features, shown, strict=True)
    ]
    whole = pair_sightings(middles, name, joints, every)
    if not len(whole.x):
        return None
    image, floor = np.full((2, len(whole.x), len(points), 2), np.nan)
    for log, (t, places, variance) in enumerate(shown):
        mine = np.flatnonzero(whole.log == log)
        at = np.searchsorted(t, whole.t[mine])
        image[mine] = places[at]
        floor[mine] = variance[at]
    return ThingSightings(whole, image, floor, np.array(list(points.values())), tuple(points))


def _images_of_board(found: Features, names: Sequence[str]) -> tuple[Array, Array, Array]:
    """Times (N,) s of all images that show one of these
    tracks, positions (N,C,2) px, and their variance.
    """
    tracks = [(k, found.tracks[name]) for k, name in enumerate(names) if name in found.tracks]
    seen = [(k, one, np.isfinite(one.values).all(axis=1)) for k, one in tracks]
    t = np.unique(np.concatenate([one.t[sound] for _, one, sound in seen] or [np.zeros(0)]))
    image, floor = np.full((2, len(t), len(names), 2), np.nan)
    for k, one, sound in seen:
        at = np.searchsorted(t, one.t[sound])
        image[at, k] = one.values[sound]
        floor[at, k] = 0.0 if one.std is None else np.square(one.std[sound])
    return t, image, floor


def _mean_of_points(image: Array) -> Array:
    """The mean (N,2) of the points seen."""
    return np.asarray(np.nanmean(image, axis=1)) if len(image) else np.zeros((0, 2))


def group_points(points: Array) -> Array:
    """Assignment (G,C), bool, of points (C,3) to at most GROUPS parts."""
    seeds = points[choose_farthest_rows(points, GROUPS)]
    nearest = np.argmin(np.square(points[:, None] - seeds).sum(axis=-1), axis=1)
    return np.asarray(nearest == np.arange(len(seeds))[:, None])


def _board_coordinates(points: Array) -> Array:
    """Points (C,3) m as (C,2) along a board's two longest
    axes, in REACH of its diagonal; (C,0) of a single one.
    """
    if len(points) == 1:
        return np.zeros((1, 0))
    apart = points - points.mean(axis=0)
    return np.asarray(
        apart @ np.linalg.svd(apart)[2][:2].T / (REACH * np.linalg.norm(np.ptp(points, axis=0)))
    )


def average_points(
    shown: ThingSightings, sound: Array, residual: Array, parts: Array, most: int
) -> tuple[PointMeans, Pairs, float]:
    """Means of the points in each part (G,C), at most `most`
    rows, and the variance of one point about them, px².

    sound (N,C): points in use · residual (N,C,2) px.
    Where parts are single points that variance is 0.
    """
    kept = np.flatnonzero((sound[:, None] & parts).any(axis=(1, 2)))
    kept = kept[choose_farthest_rows(shown.whole.x[kept], max(most // len(parts), 1))]
    member = sound[kept][:, None] & parts
    at, part = np.nonzero(member.any(axis=-1))
    picture = kept[at]
    own = member[at, part]
    count = own.sum(axis=1)
    view = PointMeans(
        shown.whole.x,
        shown.whole.log,
        _board_coordinates(shown.points),
        picture,
        own / count[:, None],
    )
    image, floor, left = (np.nan_to_num(values) for values in (shown.image, shown.floor, residual))
    within = np.square(np.where(own[..., None], left[picture] - view.of(left)[:, None], 0.0)).sum()
    alone = float(within / max(2 * (own.sum() - len(own)), 1))
    # the mean of some points has less error than one of them
    variance = np.maximum(view.of(floor), alone) / count[:, None]
    return view, replace(shown.whole.rows(picture), y=view.of(image), floor=variance), alone


def sound_sightings(weight: Array) -> Array:
    """Which sightings count, by their weights (N,C)."""
    return np.asarray(weight > _SOUND)


def sightings_of_point(shown: ThingSightings, point: int, counts: Array) -> Pairs:
    """The sightings of one point, where counts (N,C) is true."""
    rows = np.flatnonzero(counts[:, point])
    return replace(
        shown.whole.rows(rows), y=shown.image[rows, point], floor=shown.floor[rows, point]
    )


def most_seen_points(shown: ThingSightings) -> list[int]:
    """The point of each part that was seen most often, the outermost of equals."""
    far = np.linalg.norm(shown.points - shown.points.mean(axis=0), axis=1)
    worth = shown.seen.sum(axis=0) + far / (2.0 * max(float(far.max()), 1e-12))
    return [int(np.argmax(np.where(part, worth, -1.0))) for part in group_points(shown.points)]
