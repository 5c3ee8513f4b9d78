"""Checks of an episode's cameras, each by what was seen of its images once."""

from collections.abc import Iterator

import numpy as np

from ..logs.datasets.checks import BLACK_GREY, SAME_GREY, long_runs, moves_between, value_ranges
from ..perception.surface.flow import GridFlow
from ..types import Array
from .reading import EpisodeReading, StoredNumbers
from .records import Measurement

REPEATED_SHARE = 0.05
"""Share of repeated frames from which a film is not of its nominal rate."""
SATURATED_SHARE = 0.5
"""Share of white pixels from which a frame is saturated."""
BLURRED_SHARE = 0.1
"""Sharpness of a blurred frame, as a share of the sharpest quarter's."""
DROPPED_INTERVALS = 1.5
"""Median intervals between stamps, beyond which frames are missing between them."""
LATE_S = 0.01
"""s: shorter delays are less than a third of a frame at 30 Hz."""
SIGNIFICANT_SIGMA = 3.0
LATENESS_S = (0.0, 0.1, 0.2, 0.3)
"""s by which images may be late: an arm that sets off is not in them yet."""
SLOW_SHARE = 0.25
SLOWEST_SHARE = 0.02
"""Shares of the images that change whose joints are slower than those of a frozen image have to be,
in stretches up to LASTING_S and in longer ones: an arm that comes to rest looks frozen briefly."""
LASTING_S = 1.0
NOISE_SHARE = 0.5
"""Noise of a frozen film, over that of the other images: 0 in drawn films of which one image is
stored again, 0.75 and more in those of an arm at rest or out of the image."""
LEAST_CHANGES = 20
"""Fewest changing images that tell how fast joints are when images change."""


def measure_delays(reading: EpisodeReading) -> Iterator[Measurement]:
    """Delays of images against the joints by flow (s), where the evidence suffices."""
    for name, film in reading.films.items():
        found = film.delay
        if found is None:
            continue
        if not found.certain:
            text = f"{name}: no delay by the picture's motion: {found.nats:.0f} nats of evidence"
            yield Measurement(name, float("nan"), None, text, "info")
            continue
        delay = found.delay
        late = abs(delay.seconds) > max(LATE_S, SIGNIFICANT_SIGMA * delay.std_error)
        way = "late" if delay.seconds > 0.0 else "early"
        size = f"{1e3 * abs(delay.seconds):.0f} ± {1e3 * delay.std_error:.0f} ms"
        text = f"{name}: images are {size} {way} against the joints" if late else ""
        yield Measurement(name, delay.seconds, delay.std_error, text, "warning", found.shared_std_s)
        if film.arm is not None:
            nats = f"{found.joints_nats:.0f} nats over any other arm"
            text = f"{name}: its picture moves with {film.arm} ({nats})"
            yield Measurement(name, float("nan"), None, text, "info")


def measure_row_times(reading: EpisodeReading) -> Iterator[Measurement]:
    """Time (s) that a rolling shutter takes over the image, by the flow of its upper and lower
    rows."""
    for name, film in reading.films.items():
        found = film.delay
        if found is not None and found.certain and found.row_time is not None:
            yield Measurement(name, found.row_time.seconds, found.row_time.std_error)


def measure_repeats(reading: EpisodeReading) -> Iterator[Measurement]:
    """Share of frames that repeat their predecessor, among those where that can be decided."""
    for name, seen in _list_seen_cameras(reading):
        share = seen.repeats.share
        if share is None or np.median(seen.brightness) < BLACK_GREY:
            continue
        stored = seen.repeats.stored_hz
        distinct = seen.repeats.distinct_hz
        text = ""
        if share >= REPEATED_SHARE and stored is not None and distinct is not None:
            rates = f"{stored:.3g} Hz, of which {distinct:.3g} distinct"
            text = f"{name}: {rates}: {100.0 * share:.0f} % repeat"
        yield Measurement(name, share, None, text)


def measure_rates(reading: EpisodeReading) -> Iterator[Measurement]:
    """Rate of distinct frames (Hz)."""
    for name, seen in _list_seen_cameras(reading):
        if seen.repeats.distinct_hz is not None and np.median(seen.brightness) >= BLACK_GREY:
            yield Measurement(name, seen.repeats.distinct_hz)


def measure_dropped_frames(reading: EpisodeReading) -> Iterator[Measurement]:
    """Share of frames that gaps between stamps say are missing."""
    for name, seen in _list_seen_cameras(reading):
        gaps = np.diff(seen.repeats.t)
        usual = float(np.median(gaps))
        if usual <= 0.0:
            continue
        missing = np.where(gaps > DROPPED_INTERVALS * usual, np.round(gaps / usual) - 1.0, 0.0)
        count = int(missing.sum())
        text = f"{name}: {count} frames are missing between {len(gaps) + 1}" if count else ""
        yield Measurement(name, count / (count + len(gaps) + 1), None, text)


def measure_frozen_images(reading: EpisodeReading) -> Iterator[Measurement]:
    """Share of images in stretches that stay the same while joints move as they do where images
    change."""
    for name, seen in _list_seen_cameras(reading):
        same = np.append((seen.block_change < SAME_GREY)[1:], False) & (
            seen.brightness >= BLACK_GREY
        )
        runs = _long_runs(seen, same)
        if reading.joints is not None:
            runs = _runs_with_motion(seen, runs, reading.joints)
        yield _share_of_runs(name, seen, runs, "frozen while joints move")


def _runs_with_motion(
    seen: GridFlow, runs: list[tuple[int, int]], joints: StoredNumbers
) -> list[tuple[int, int]]:
    """Those runs of images during which joints move, however late the images may be.

    Joints have to be as fast as in most of the other images that change; with few of these, to move
    at all. A stretch with as much noise as the other images is no frozen one: the arm is out of it.
    """
    t = seen.repeats.t
    speeds = np.array([_joint_steps(joints, t - late_s) for late_s in LATENESS_S])
    changes = np.isfinite(seen.block_change) & (seen.block_change >= SAME_GREY)
    changes &= ~_inside_runs(runs, len(t))
    usual = 0.0
    least = 0.0
    if changes.sum() >= LEAST_CHANGES:
        usual, least = np.quantile(speeds[0][changes], [SLOW_SHARE, SLOWEST_SHARE]).tolist()
    noises = seen.repeats.noise
    live = ~_inside_runs(runs, len(t)) & np.isfinite(noises)
    most_noise = NOISE_SHARE * float(np.median(noises[live])) if live.any() else np.inf
    return [
        (first, end)
        for first, end in runs
        if np.median(noises[first + 1 : end]) <= most_noise
        and speeds[:, first + 1 : end].mean(axis=1).min()
        >= (least if t[end - 1] - t[first] > LASTING_S else usual)
        and all(
            moves_between(joints.values, joints.t, t[first] - late_s, t[end - 1] - late_s)
            for late_s in LATENESS_S
        )
    ]


def _inside_runs(runs: list[tuple[int, int]], count: int) -> Array:
    """Which of `count` images stand in a run, (count,)."""
    inside = np.zeros(count, bool)
    for first, end in runs:
        inside[first:end] = True
    return inside


def _joint_steps(joints: StoredNumbers, t: Array) -> Array:
    """Sum over joints of the steps (N,) between times t (N,) s, in their ranges; 0 of the first."""
    ranges = value_ranges(joints.values)
    total = np.zeros(len(t))
    for column, span in zip(joints.values.T, ranges.tolist(), strict=True):
        finite = np.isfinite(column)
        if span > 0.0:
            angles = np.interp(t, joints.t[finite], column[finite])
            total += np.abs(np.diff(angles, prepend=angles[:1])) / span
    return total


def measure_black_images(reading: EpisodeReading) -> Iterator[Measurement]:
    """Share of images in black stretches."""
    for name, seen in _list_seen_cameras(reading):
        runs = _long_runs(seen, seen.brightness < BLACK_GREY)
        yield _share_of_runs(name, seen, runs, "black")


def measure_saturated_images(reading: EpisodeReading) -> Iterator[Measurement]:
    """Share of images in stretches that are mostly white."""
    for name, seen in _list_seen_cameras(reading):
        runs = _long_runs(seen, seen.saturated > SATURATED_SHARE)
        yield _share_of_runs(name, seen, runs, "white")


def measure_blurred_images(reading: EpisodeReading) -> Iterator[Measurement]:
    """Share of images in stretches far less sharp than the sharpest quarter of the episode."""
    for name, seen in _list_seen_cameras(reading):
        lit = seen.brightness >= BLACK_GREY
        usual = float(np.quantile(seen.sharpness[lit], 0.75)) if lit.any() else 0.0
        runs = _long_runs(seen, lit & (seen.sharpness < BLURRED_SHARE * usual))
        found = _share_of_runs(name, seen, runs, "blurred, or shows a plain surface,")
        yield Measurement(name, found.value, None, found.text, "info")


def measure_sharpness(reading: EpisodeReading) -> Iterator[Measurement]:
    """Logarithm of the median variance of the images' Laplacian (ln grey²)."""
    for name, seen in _list_seen_cameras(reading):
        yield Measurement(name, float(np.log(max(float(np.median(seen.sharpness)), 1e-3))))


def measure_brightness(reading: EpisodeReading) -> Iterator[Measurement]:
    """Median over images of the 99th percentile of their grey levels."""
    for name, seen in _list_seen_cameras(reading):
        yield Measurement(name, float(np.median(seen.brightness)))


def measure_missing_images(reading: EpisodeReading) -> Iterator[Measurement]:
    """Share of a camera's images that cannot be decoded."""
    for name, film in reading.films.items():
        if film.count:
            text = (
                f"{name}: {film.unreadable} of {film.count} images cannot be read"
                if film.unreadable
                else ""
            )
            yield Measurement(name, film.unreadable / film.count, None, text, "lost")


def _list_seen_cameras(reading: EpisodeReading) -> Iterator[tuple[str, GridFlow]]:
    for name, film in reading.films.items():
        if film.seen is not None:
            yield name, film.seen


def _long_runs(seen: GridFlow, which: Array) -> list[tuple[int, int]]:
    """Runs (first, beyond the last) of images that are long enough to report."""
    ns = np.rint(seen.repeats.t * 1e9).astype(np.int64).tolist()
    return list(long_runs(which, ns))


def _share_of_runs(
    name: str, seen: GridFlow, runs: list[tuple[int, int]], what: str
) -> Measurement:
    """Share of a camera's images in long runs."""
    t = seen.repeats.t
    count = sum(end - first for first, end in runs)
    if not count:
        return Measurement(name, 0.0)
    first, end = max(runs, key=lambda run: run[1] - run[0])
    if count == len(t):
        return Measurement(name, 1.0, None, f"{name}: {what} in all {count} images")
    longest = f"at the longest {t[first]:.2f} to {t[end - 1]:.2f} s"
    text = f"{name}: {what} in {count} of {len(t)} images, {longest}"
    return Measurement(name, count / len(t), None, text)
