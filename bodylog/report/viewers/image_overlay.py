"""Measurements and predictions drawn on images."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FormatError, UsageError
from ...io.atomic_files import replace_atomically
from ...overlay_style import PREDICTED, ellipse_corners, measurement_ink
from ...types import Array, Estimate, Features, LazyImage, Recording, Series

_RIM = (20, 20, 20)
# BGR
_MEASURED, _PREDICTED, _HAND = (
    ink.rgb[::-1] for ink in (measurement_ink("effector"), PREDICTED, measurement_ink("hand"))
)
_WIDTH = 480
_POSE_WIDTH = 640
MOST_POSES = 16
"""Most images of still poses on a page."""
# images per row of a sheet, and their width there in px
_ACROSS = 3
_TILE = 320
FINE = 4  # cv2 draws in 1/16 px with shift 4


@dataclass(frozen=True, eq=False)
class OverlayPicture:
    """One image with its marks drawn: t s · image (H,W,3) uint8 BGR · caption."""

    t: float
    image: Array
    caption: str


def draw_overlay(
    image: Array, seen: Array | None, predicted: Array | None, cov: Array | None, hand: Array | None
) -> Array:
    """A copy of image (H,W,3) BGR: measured ring, predicted
    cross with the 2σ ellipse of cov (2,2) px², hand square.
    """
    import cv2

    drawn = image.copy()
    for width, inks in ((4, (_RIM,) * 3), (2, (_MEASURED, _PREDICTED, _HAND))):
        # a dark rim shows on any ground
        if (place := _drawable_point(predicted)) is not None:
            for arm in (np.array([5.0, 0.0]), np.array([0.0, 5.0])):
                cv2.line(
                    drawn,
                    subpixel_place(place - arm),
                    subpixel_place(place + arm),
                    inks[1],
                    width,
                    cv2.LINE_AA,
                    FINE,
                )
            _draw_ellipse(drawn, place, cov, inks[1], width)
        if (place := _drawable_point(seen)) is not None:
            cv2.circle(drawn, subpixel_place(place), 11 << FINE, inks[0], width, cv2.LINE_AA, FINE)
        if (place := _drawable_point(hand)) is not None:
            cv2.rectangle(
                drawn,
                subpixel_place(place - 9.0),
                subpixel_place(place + 9.0),
                inks[2],
                width,
                cv2.LINE_AA,
                FINE,
            )
    return drawn


def draw_pictures(
    recording: Recording, features: Features, estimate: Estimate, count: int = 6
) -> tuple[OverlayPicture, ...]:
    """`count` frames of each camera, evenly over the log,
    with measurements and predictions; () without a camera.
    """
    films = {} if recording.cameras.frames is None else {"": recording.cameras.frames}
    wanted = [recording.duration_s * (k + 0.5) / count for k in range(count)]
    drawn: list[OverlayPicture] = []
    for camera, frames in (films | dict(recording.cameras.views)).items():
        due = iter(wanted)
        after = next(due)
        for frame in frames():
            if frame.t >= after:
                with suppress(FormatError):
                    # a damaged image: health counts it, the next one is shown
                    drawn.append(_draw_picture(camera, frame.t, frame.image, features, estimate))
                    if (after := next(due, np.inf)) == np.inf:
                        break
    return tuple(drawn)


def draw_pose_pictures(
    recording: Recording, features: Features, estimate: Estimate, times: float
) -> tuple[OverlayPicture, ...]:
    """Images of still poses with an arrow from each point as measured to where the calibration
    alone expects it, `times` as long as it is; of many images those with the largest errors.
    """
    films = {} if recording.cameras.frames is None else {"": recording.cameras.frames}
    poses = np.unique([t for series in estimate.kinematic.values() for t in series.t.tolist()])
    found = list[tuple[float, str, LazyImage, Array]]()
    for camera, frames in (films | dict(recording.cameras.views)).items():
        tracks = [name for name in estimate.kinematic if name.rpartition("/")[0] == camera]
        for frame in frames():
            arrows = [_arrow_at_time(features, estimate, name, frame.t) for name in tracks]
            sound = np.array([one for one in arrows if one is not None]).reshape(-1, 4)
            error = float(np.square(sound[:, 2:] - sound[:, :2]).sum() / max(len(sound), 1)) ** 0.5
            found.append((error, camera, frame, sound))
    found.sort(key=lambda one: -one[0])
    chosen = sorted(found[:MOST_POSES], key=lambda one: (one[1], one[2].t))
    drawn = []
    for error, camera, frame, points in chosen:
        number = int(np.searchsorted(poses, frame.t - 1e-6)) + 1
        text = f"{f'{camera} · ' if camera else ''}pose {number} · {len(points)} points"
        text += f" · {error:.2f} px (RMS distance)" * (len(points) > 0)
        with suppress(FormatError):  # a damaged image: health counts it
            image = _draw_arrows(frame.image, points, times)
            drawn.append(OverlayPicture(frame.t, image, text))
    return tuple(drawn)


def measure_images(recording: Recording) -> dict[str, tuple[int, int]]:
    """(width, height) px of each camera's first sound image, "" the first camera."""
    films = {} if recording.cameras.frames is None else {"": recording.cameras.frames}
    sizes = dict[str, tuple[int, int]]()
    for camera, frames in (films | dict(recording.cameras.views)).items():
        for frame in frames():
            with suppress(FormatError):
                height, width = frame.image.shape[:2]
                sizes[camera] = (width, height)
                break
    return sizes


def overlay_sheet(
    drawn: Sequence[OverlayPicture], out: Path, hand: bool = True, legend: str | None = None
) -> None:
    """Write the images side by side, each with a caption
    below, as one PNG; UsageError: no image, suffix.

    legend: what the marks mean; None for those of a track.
    """
    if not drawn:
        raise UsageError(
            f"{out}: no images to put on the sheet; type: bodylog info LOG to see its cameras"
        )
    tiles = [_captioned_tile(picture) for picture in drawn]
    height = max(len(tile) for tile in tiles)
    sheet = np.full(
        (-(-len(tiles) // _ACROSS) * height, min(_ACROSS, len(tiles)) * _TILE, 3), 255, np.uint8
    )
    for i, tile in enumerate(tiles):
        top = i // _ACROSS * height
        left = i % _ACROSS * _TILE
        sheet[top : top + len(tile), left : left + _TILE] = tile
    legend = legend or (
        "green ring: measured | yellow cross, ellipse: predicted, 2 sigma"
        + " | red square: hand" * hand
    )
    key = _caption_strip(legend, sheet.shape[1])
    write_png(np.vstack([sheet, key]), out)


def write_png(image: Array, out: Path) -> None:
    """Write an image (H,W,3) uint8 BGR as PNG; UsageError for another suffix."""
    import cv2

    if out.suffix.lower() != ".png":
        raise UsageError(
            f"{out}: suffix '{out.suffix}'; possible: .png; type: {out.with_suffix('.png')}"
        )
    with replace_atomically(out) as beside:
        beside.write_bytes(cv2.imencode(".png", image)[1].tobytes())


def scale_image(image: Array, width: int) -> Array:
    """The image scaled to a width of `width` px."""
    import cv2

    height = max(1, round(image.shape[0] * width / image.shape[1]))
    method = cv2.INTER_AREA if width < image.shape[1] else cv2.INTER_CUBIC
    return cv2.resize(image, (width, height), interpolation=method)


def _draw_picture(
    camera: str, t: float, image: Array, features: Features, estimate: Estimate
) -> OverlayPicture:
    at = f"{camera}/" if camera else ""
    name = f"{at}effector"
    seen = _place_at_time(features.tracks.get(name), t)
    hand = _place_at_time(features.tracks.get(f"{at}hand"), t)
    mean = _place_at_time(estimate.predicted.get(name), t)
    row = _nearest_row(estimate.predicted.get(name), t)
    cov = (
        estimate.predicted_cov[name][row]
        if row is not None and name in estimate.predicted_cov
        else None
    )
    caption = (
        f"{f'{camera} · ' if camera else ''}{t:.2f} s · {'not seen' if seen is None else 'seen'}"
    )
    if seen is not None and mean is not None:
        caption += f" · {np.hypot(*(seen - mean)):.1f} px apart"
    return OverlayPicture(t, _draw_enlarged_overlay(image, seen, mean, cov, hand), caption)


def _draw_enlarged_overlay(
    image: Array, seen: Array | None, mean: Array | None, cov: Array | None, hand: Array | None
) -> Array:
    """The overlay on the image scaled to `_WIDTH` px, so that marks have one size."""
    scale = _WIDTH / image.shape[1]
    seen, mean, hand = (None if p is None else (p + 0.5) * scale - 0.5 for p in (seen, mean, hand))
    return draw_overlay(
        scale_image(image, _WIDTH), seen, mean, None if cov is None else cov * scale**2, hand
    )


def _arrow_at_time(features: Features, estimate: Estimate, name: str, t: float) -> Array | None:
    """u, v as measured and u, v as the calibration expects, px, at t s; None where not seen."""
    seen = _place_at_time(features.tracks.get(name), t)
    expected = _place_at_time(estimate.kinematic[name], t)
    return None if seen is None or expected is None else np.concatenate([seen, expected])


def _draw_arrows(image: Array, arrows: Array, times: float) -> Array:
    """The image _POSE_WIDTH px wide with arrows (K,4) px, `times` as long as they are."""
    import cv2

    scale = _POSE_WIDTH / image.shape[1]
    drawn = scale_image(image, _POSE_WIDTH)
    for start, end in ((row[:2], row[2:]) for row in arrows):
        place = (start + 0.5) * scale - 0.5
        tip = place + times * scale * (end - start)
        if (np.abs(tip) < 1e5).all():
            for width, ink in ((4, _RIM), (2, _PREDICTED)):
                ends = subpixel_place(place), subpixel_place(tip)
                cv2.arrowedLine(drawn, *ends, ink, width, cv2.LINE_AA, FINE, 0.25)
            cv2.circle(drawn, subpixel_place(place), 3 << FINE, _MEASURED, -1, cv2.LINE_AA, FINE)
    return drawn


def _place_at_time(track: Series | None, t: float) -> Array | None:
    row = _nearest_row(track, t)
    return None if track is None or row is None else _drawable_point(track.values[row])


def _nearest_row(track: Series | None, t: float, tolerance: float = 0.1) -> int | None:
    """The nearest row within `tolerance` s of t."""
    if track is None or not len(track.t):
        return None
    row = int(np.abs(track.t - t).argmin())
    return row if abs(track.t[row] - t) <= tolerance else None


def _drawable_point(point: Array | None) -> Array | None:
    """The point (2,) px if it is finite and can be drawn."""
    return point if point is not None and bool((np.abs(point) < 1e5).all()) else None


def subpixel_place(point: Array | Sequence[float]) -> tuple[int, int]:
    """A place (2,) px in OpenCV's units of a drawing with `shift=FINE`."""
    return round(float(point[0]) * (1 << FINE)), round(float(point[1]) * (1 << FINE))


def _draw_ellipse(
    image: Array, centre: Array, cov: Array | None, ink: tuple[int, int, int], width: int
) -> None:
    import cv2

    if cov is None or not np.isfinite(cov).all() or not 0 < np.linalg.eigvalsh(cov)[-1] < 1e8:
        return
    corners = ellipse_corners(centre[None], cov[None])
    if np.isfinite(corners).all():
        fixed = np.rint(corners * (1 << FINE)).astype(np.int32)
        cv2.polylines(image, fixed, True, ink, width, cv2.LINE_AA, FINE)


def _captioned_tile(picture: OverlayPicture) -> Array:
    # cv2's fonts have only ASCII
    return np.vstack(
        [
            scale_image(picture.image, _TILE),
            _caption_strip(picture.caption.replace("·", "|"), _TILE),
        ]
    )


def _caption_strip(text: str, width: int) -> Array:
    """A strip (26,width,3) of dark text on white."""
    import cv2

    strip = np.full((26, width, 3), 255, np.uint8)
    cv2.putText(strip, text, (6, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (60, 50, 40), 1, cv2.LINE_AA)
    return strip
