"""Check an episode: black and frozen cameras, joints
that wrap or never move, lengths, gaps in time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ...errors import BodylogError
from ...wording import list_in_words
from ..formats import payload_views
from ..images import messages
from ..joint_units import joint_unit
from ..limits import LIMITS, Input
from ..records import Array, Batch
from .episode_log import JOINTS, EpisodeCamera, EpisodeLog, EpisodeSignal
from .lerobot_layout import (
    EPISODE_TABLES,
    EPISODES,
    TASK_TABLE,
    TASKS,
    DatasetLayout,
    read_task_texts,
)

BLACK_GREY = 20
"""Grey levels: black in video is 16 (BT.601), and a covered sensor's noise a few levels more."""
_BLOCK = 8
"""px: block size of a video codec."""
SAME_GREY = 4.0
"""Grey levels: no block's mean differs by more when the same image is encoded again. Measured on an
image repeated 60 times: AV1 (crf 30) 0, H.264 (crf 23) 1; on a real MPEG-4 recording whose camera
repeats images 2.5. A new image of that recording differs by at least 112."""
_LONG_S = 0.5
_MANY = 5
"""Shortest time, and fewest images, for a camera to count as frozen or black."""
_MOVED = 0.02
"""Share of its range that a joint must cross while a camera's image stays the same."""
_MOST_LISTED = 100_000
"""Numbers of episodes among which those that are not listed are named."""
_GAP = 5.0
"""Median time steps beyond which there is a gap."""


@dataclass
class _ImageRecord:
    """Record of a camera's images: brightness (grey levels),
    change from the previous one, time (ns) of each.
    """

    bright: list[float] = field(default_factory=list)
    change: list[float] = field(default_factory=list)
    ns: list[int] = field(default_factory=list)
    last: Array | None = None

    def add(self, ns: int, image: Array) -> None:
        """Record the next image (H,W,3)."""
        import cv2

        grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_BGR2GRAY)
        small = block_means(grey)
        same = self.last is not None and self.last.shape == small.shape
        self.change.append(
            float(np.abs(small - self.last).max()) if same and self.last is not None else np.inf
        )
        self.bright.append(float(np.percentile(grey, 99)))
        self.ns.append(ns)
        self.last = small


class Checks:
    """Checks an episode from its batches."""

    def __init__(self, log: EpisodeLog, limits: Input = LIMITS) -> None:
        """For an episode that will be read from end to end."""
        self._log = log
        topics = {topic.id: topic for topic in log.topics if topic.id in log.cameras}
        self._decoders = {
            number: messages.make_image_decoder(topic, limits.max_image_mpx)
            for number, topic in topics.items()
        }
        self._records = {number: _ImageRecord() for number in topics}

    def add(self, batch: Batch) -> None:
        """Examine the images of a batch."""
        if (decode := self._decoders.get(batch.topic_id)) is None:
            return
        for ns, payload in zip(batch.log_ns.tolist(), payload_views(batch), strict=True):
            try:
                self._records[batch.topic_id].add(ns, decode(bytes(payload), 1))
            except BodylogError:  # the log counts it
                continue

    def texts(self) -> Iterator[str]:
        """One line for each problem."""
        joints = next((one for one in self._log.signals if one.topic == JOINTS), None)
        for number, record in self._records.items():
            yield from _check_camera_images(self._log.cameras[number], record, joints)
        yield from () if joints is None else _check_joints(joints)
        yield from length_texts(self._log)


def block_means(grey: Array) -> Array:
    """Means of the blocks of a grey image (H,W) uint8, (H/8,W/8) float32."""
    import cv2

    size = max(grey.shape[1] // _BLOCK, 1), max(grey.shape[0] // _BLOCK, 1)
    return np.asarray(cv2.resize(grey.astype(np.float32), size, interpolation=cv2.INTER_AREA))


def _check_camera_images(
    camera: EpisodeCamera, record: _ImageRecord, joints: EpisodeSignal | None
) -> Iterator[str]:
    name = camera.topic
    if not record.ns:
        return
    black = np.array(record.bright) < BLACK_GREY
    if black.all():
        yield f"{name}: the camera is black in all {len(black)} images"
        return
    for first, end in long_runs(black, record.ns):
        yield f"{name}: the camera is black {_describe_time_range(record.ns, first, end)}"
    same = np.append((np.array(record.change) < SAME_GREY)[1:], False)
    yield from _find_frozen_images(
        name, record.ns, list(long_runs(same & ~black, record.ns)), joints
    )


def _find_frozen_images(
    name: str, ns: Sequence[int], runs: list[tuple[int, int]], joints: EpisodeSignal | None
) -> Iterator[str]:
    """Runs of identical images while joints move."""
    if joints is not None:
        moves = partial(moves_between, joints.values, joints.ns)
        runs = [(first, end) for first, end in runs if moves(ns[first], ns[end - 1])]
    if not runs:
        return
    moving = "" if joints is None else " while joints move"
    lasts = [(ns[end - 1] - ns[first]) / 1e9 for first, end in runs]
    longest = _describe_time_range(ns, *runs[int(np.argmax(lasts))])
    if len(runs) == 1:
        yield f"{name}: the camera is frozen {longest}{moving}"
    else:
        whole = (ns[-1] - ns[0]) / 1e9
        often = f"{len(runs)} times, {sum(lasts):.1f} s of {whole:.1f} s{moving}"
        yield f"{name}: the camera is frozen {often}, at the longest {longest}"


def long_runs(which: Array, ns: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Runs (first, beyond the last) of images at ns (N,) that are long enough to report."""
    edges = np.flatnonzero(
        np.diff(np.concatenate([[False], which, [False]]).astype(np.int8))
    ).reshape(-1, 2)
    for first, end in edges.tolist():
        if end - first >= _MANY and ns[end - 1] - ns[first] >= _LONG_S * 1e9:
            yield first, end


def _describe_time_range(ns: Sequence[int], first: int, end: int) -> str:
    begin, last = ((ns[k] - ns[0]) / 1e9 for k in (first, end - 1))
    return f"from {begin:.2f} to {last:.2f} s ({end - first} images)"


def moves_between(values: Array, times: Array, first: float, last: float) -> bool:
    """Whether any joint of values (N,K) at times (N,) crosses part of its range from `first` to
    `last`."""
    during = values[(times >= first) & (times <= last)]
    if not len(during):
        return False
    whole = value_ranges(values)
    part = value_ranges(during)
    return bool((part > _MOVED * whole)[whole > 0].any())


def value_ranges(values: Array) -> Array:
    """Range of each column (K,), 0 if it holds no number."""
    known = np.isfinite(values)
    low = np.where(known, values, np.inf).min(axis=0)
    high = np.where(known, values, -np.inf).max(axis=0)
    return np.where(known.any(axis=0), high - low, 0.0)


def _check_joints(joints: EpisodeSignal) -> Iterator[str]:
    ranges = value_ranges(joints.values)
    still = [name for name, one in zip(joints.names, ranges, strict=True) if one == 0]
    if still:
        yield (
            f"{joints.topic}: {', '.join(still)} {'is' if len(still) == 1 else 'are'} constant "
            "throughout"
        )
    if missing := int((~np.isfinite(joints.values)).sum()):
        yield f"{joints.topic}: {missing} of {joints.values.size} readings are not finite numbers"
    yield from _find_joint_wraps(joints)
    steps = np.diff(joints.ns) / 1e9
    usual = float(np.median(steps)) if len(steps) else 0.0
    if usual > 0 and (gaps := np.flatnonzero(steps > _GAP * usual)).size:
        at = (joints.ns[gaps[0]] - joints.ns[0]) / 1e9
        yield (
            f"{joints.topic}: {len(gaps)} gaps in time, the first of {steps[gaps[0]]:.3g} s at "
            f"{at:.2f} s"
        )


def _find_joint_wraps(joints: EpisodeSignal) -> Iterator[str]:
    """Joints whose readings jump by more than half a turn."""
    known = joint_unit(joints.metadata, "rad")
    if known.turn is None:
        return
    for name, column in zip(joints.names, joints.values.T * known.factor, strict=True):
        steps = np.diff(column[np.isfinite(column)])
        if count := int((np.abs(steps) > 0.5 * known.turn).sum()):
            yield (
                f"{joints.topic}: {name} wraps around {count} times: it leaps by more than half "
                "a turn"
            )


def length_texts(log: EpisodeLog) -> Iterator[str]:
    """What is wrong with an episode's length."""
    declared = log.episode.length
    rows = max((len(one.ns) for one in log.signals), default=0)
    if declared is not None and declared != rows:
        yield f"the dataset lists {declared} rows for this episode, its table holds {rows}"


def of_dataset(known: DatasetLayout) -> Iterator[str]:
    """Problems of the dataset as a whole: info.json against the other files."""
    there = known.present()
    info = known.info
    old = known.one_file_each
    listed = len(known.rows)
    if isinstance(total := info.get("total_episodes"), int) and total != listed:
        unlisted = sorted(set(range(min(total, _MOST_LISTED))).difference(known.rows))
        some = f"; not listed: {list_in_words([*map(str, unlisted)])}" if unlisted else ""
        yield f"info.json says total_episodes {total}, {listed} are listed{some}"
    if missing := sorted(set(known.rows).difference(there)):
        yield (
            f"{listed} episodes are listed, the tables of {len(there)} are there; without a table: "
            f"{list_in_words([*map(str, missing)])}"
        )
    listing = EPISODES if old else EPISODE_TABLES
    for number, row in known.rows.items():
        if not isinstance(row.get("length"), int):
            found = f"{row.get('length')!r:.40}"
            yield f"{listing}: length of episode {number} is {found}; a number of rows is expected"
    lengths = [row.get("length") for row in known.rows.values()]
    whole = sum(length for length in lengths if isinstance(length, int))
    if isinstance(total := info.get("total_frames"), int) and total != whole:
        yield f"info.json says total_frames {total}, the episodes listed have {whole}"
    tasks = len(read_task_texts(known))
    if isinstance(total := info.get("total_tasks"), int) and total != tasks:
        yield f"info.json says total_tasks {total}, {TASKS if old else TASK_TABLE} lists {tasks}"
