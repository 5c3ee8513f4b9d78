"""The robot's own surface over images: the URDF's skeleton,
and corners as measured and as predicted, or their tracks, by link.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import FormatError
from ...types import SURFACE_VIEWS, Array, Estimate, Recording
from ..page.tables import escape_text
from ..viewers.image_overlay import FINE, OverlayPicture, scale_image, subpixel_place
from .canvas import LINES

LEGEND = "ring: measured | cross: predicted | white: skeleton of the URDF | a colour for each link"
WIDTH = 640
_MARGIN = 0.2
"""Share of the arm's extent that is shown around it."""
_LEAST_SHARE = 1.0 / 3.0
"""Share of an image that is shown at least."""
_RIM = (20, 20, 20)
_BONE = (255, 255, 255)
_FOREIGN = (150, 150, 150)
_MOST_IMAGES = 12
_MOST_SHAPES = 2000
_FARTHEST_PX = 1e5


@dataclass(frozen=True, eq=False)
class SurfaceView:
    """What is drawn on one image: t s · bones (S,4) px: segments of the skeleton · corners (k,5):
    u, v measured, u, v predicted, number of the link · trails (link or −1, places (n,2) px).
    """

    t: float
    bones: Array
    corners: Array
    trails: tuple[tuple[int, Array], ...] = ()


def link_colour(number: int) -> tuple[int, int, int]:
    """The colour (b, g, r) of a link's corners; grey for none."""
    if number < 0:
        return _FOREIGN
    code = LINES[number % (len(LINES) - 1)]
    red, green, blue = (int(code[place : place + 2], 16) for place in (1, 3, 5))
    return blue, green, red


def draw_surface(image: Array, view: SurfaceView) -> Array:
    """A copy of an image (H,W,3) BGR, WIDTH px wide, with the view on it: a ring where a corner
    is measured, a cross where it is predicted, a line along each trail.
    """
    import cv2

    scale = WIDTH / image.shape[1]
    drawn = scale_image(image, WIDTH)
    for u, v, a, b in np.asarray(view.bones, float).reshape(-1, 4) * scale:
        if max(map(abs, (u, v, a, b))) < _FARTHEST_PX:
            for width, ink in ((5, _RIM), (2, _BONE)):
                cv2.line(
                    drawn,
                    subpixel_place((u, v)),
                    subpixel_place((a, b)),
                    ink,
                    width,
                    cv2.LINE_AA,
                    FINE,
                )
            cv2.circle(drawn, subpixel_place((u, v)), 4 << FINE, _BONE, -1, cv2.LINE_AA, FINE)
    for number, places in view.trails:
        line = np.rint(np.asarray(places) * scale * (1 << FINE)).astype(np.int32)
        for width, ink in ((4, _RIM), (2, link_colour(number))):
            cv2.polylines(drawn, [line], False, ink, width, cv2.LINE_AA, FINE)
        cv2.circle(drawn, tuple(line[-1].tolist()), 3 << FINE, ink, -1, cv2.LINE_AA, FINE)
    for u, v, a, b, number in np.asarray(view.corners, float).reshape(-1, 5):
        ink = link_colour(int(number))
        ring = np.array([u, v]) * scale
        cross = np.array([a, b]) * scale
        for width, colour in ((4, _RIM), (2, ink)):
            cv2.circle(drawn, subpixel_place(ring), 6 << FINE, colour, width, cv2.LINE_AA, FINE)
        for arm in (np.array([4.0, 0.0]), np.array([0.0, 4.0])):
            begin = subpixel_place(cross - arm)
            end = subpixel_place(cross + arm)
            cv2.line(drawn, begin, end, (255, 255, 255), 1, cv2.LINE_AA, FINE)
    return drawn


def surface_pictures(recording: Recording, estimate: Estimate) -> tuple[OverlayPicture, ...]:
    """The images of which an estimate by the robot's surface has views, drawn over."""
    pictures = list[OverlayPicture]()
    for camera, found in _declared_cameras(estimate):
        views = list(_declared_views(found.get("images")))
        frames = (
            recording.cameras.frames if camera == "camera" else recording.cameras.views.get(camera)
        )
        for t, image in pick_images(frames, [view.t for view in views]).items():
            view = next(one for one in views if one.t == t)
            drawn = draw_surface(*_crop_to_arm(image, view))
            pictures.append(OverlayPicture(t, drawn, _describe_view(camera, view)))
    return tuple(pictures)


def _crop_to_arm(image: Array, view: SurfaceView) -> tuple[Array, SurfaceView]:
    """The part of an image around the arm, with the image's shape, and the view on it."""
    size = np.array(image.shape[1::-1], float)
    places = np.concatenate([view.bones.reshape(-1, 2), view.corners[:, :2]])
    places = places[((places > 0.0) & (places < size)).all(axis=1)]
    if not len(places):
        return image, view
    low = places.min(axis=0)
    high = places.max(axis=0)
    share = float(((1.0 + 2.0 * _MARGIN) * (high - low) / size).max())
    shown = np.ceil(size * min(max(share, _LEAST_SHARE), 1.0))
    begin = np.clip(0.5 * (low + high - shown), 0.0, size - shown).astype(int)
    end = begin + shown.astype(int)
    part = image[begin[1] : end[1], begin[0] : end[0]]
    bones = view.bones - np.tile(begin, 2)
    corners = view.corners - [*begin, *begin, 0]
    return part, SurfaceView(view.t, bones, corners)


def pick_images(frames: Any, instants: Sequence[float]) -> dict[float, Array]:
    """The images (H,W,3) BGR of a film at these instants (s), each at most 1 ms apart."""
    found = dict[float, Array]()
    if frames is None or not instants:
        return found
    for frame in frames():
        t = min(instants, key=lambda one: abs(one - frame.t))
        if abs(t - frame.t) < 1e-3 and t not in found:
            with suppress(FormatError):  # a damaged image: health counts it
                found[t] = frame.image
        if frame.t > max(instants):
            break
    return found


def surface_section(pictures: Sequence[str], estimate: Estimate) -> str:
    """The pictures, as HTML figures, as part of a page with
    what they show; "" where there are none.
    """
    if not pictures:
        return ""
    lines = [
        "ring: a corner of the robot as the image shows it · cross: where URDF, camera, delay and "
        "joints put it · white: the URDF's link origins, joined; crosses inside their rings, and a "
        "skeleton that bends where the arm does, mean that the calibration is right"
    ]
    for camera, found in _declared_cameras(estimate):
        foreign = found.get("foreign")
        if isinstance(foreign, int | float) and math.isfinite(foreign):
            text = "of the moving corners are foreign: they follow neither a link nor the scene"
            lines.append(f"{camera}: {foreign:.0%} {text}")
        links = found.get("links")
        if isinstance(links, list):
            lines.append(f"{camera}: {_list_links(links, found.get('images'))}")
    explained = "".join(f'<p class="soft">{line}</p>\n' for line in lines)
    shown = "\n".join(pictures)
    return f'<h2>The robot\'s own surface</h2>\n{explained}<div class="pictures">\n{shown}\n</div>'


def _list_links(links: Sequence[Any], images: Any) -> str:
    """The links whose corners are drawn, each in its colour."""
    shown = sorted({int(row[4]) for view in _declared_views(images) for row in view.corners})
    parts = list[str]()
    for number in shown:
        if 0 <= number < len(links):
            blue, green, red = link_colour(number)
            name = escape_text(str(links[number])[:60])
            parts.append(f'<b style="color:rgb({red},{green},{blue})">{name}</b>')
    return " · ".join(parts)


def _describe_view(camera: str, view: SurfaceView) -> str:
    off = view.corners[:, :2] - view.corners[:, 2:4]
    size = float(np.sqrt(np.square(off).mean())) if len(off) else 0.0
    return f"{camera} · {view.t:.2f} s · {len(off)} corners, {size:.2f} px off per axis (RMS)"


def _declared_cameras(estimate: Estimate) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Cameras with views in an estimate's settings; a damaged entry is left out."""
    found = estimate.settings.get(SURFACE_VIEWS)
    for camera, one in found.items() if isinstance(found, Mapping) else ():
        if isinstance(one, Mapping):
            yield str(camera), one


def _declared_views(images: Any) -> Iterator[SurfaceView]:
    """The views among plain values; what is damaged is left out."""
    for one in images[:_MOST_IMAGES] if isinstance(images, list) else ():
        with suppress(TypeError, ValueError, KeyError):
            bones = np.array(one["bones"], float).reshape(-1, 4)[:_MOST_SHAPES]
            corners = np.array(one["corners"], float).reshape(-1, 5)[:_MOST_SHAPES]
            t = float(one["t"])
            sound = np.abs(corners).max(initial=0.0) < _FARTHEST_PX and np.isfinite(bones).all()
            if sound and math.isfinite(t):
                yield SurfaceView(t, bones, corners)
