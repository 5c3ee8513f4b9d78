"""Which colours a log offers: HSV ranges of its saturated blobs, those that move with the joints first."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import FormatError, LogError
from ..types import Array, Recording
from . import blobs, choose
from .ranges import SATURATION, VALUE, Range, between, hues, nearest

_LOOKED_AT = 120
_SHEET = 6
_WIDTH = 9
_SHARE = 2e-4


@dataclass(frozen=True, eq=False)
class Proposal:
    """One colour of a log: its name, low and high (h, s, v), how often it is seen (0..1), how far it strays (px).

    `joints` is the share (0..1) of its motion that the joints explain; 0 where there are no joints.
    """

    name: str
    low: tuple[int, int, int]
    high: tuple[int, int, int]
    seen: float
    strays: float
    joints: float


def propose(
    recording: Recording, effector_uv: tuple[float, float] | None = None
) -> tuple[tuple[Proposal, ...], Array]:
    """Proposals, the likeliest effector first, and a contact sheet (H,W,3) BGR; LogError where there are no pictures.

    `effector_uv` (px) says where the effector is in the first picture: the colour found there comes first.
    """
    picked = _picked(recording)
    count = sum(1 for _ in picked())
    if not count:
        raise LogError(f"{_none(recording)}; type: bodylog info LOG")
    ranges = [_range(hue) for hue in _peaks(image for _, image in picked())]
    if not ranges:
        raise LogError(f"nothing saturated in {count} pictures, so no colour to tell things by; type: bodylog view LOG")
    shown = set(np.linspace(0, count - 1, min(_SHEET, count)).astype(int).tolist())
    t, found, kept, width = np.zeros(count), [], {}, 0
    for index, (t[index], image) in enumerate(picked()):
        found.append(blobs.look([image], ranges)[0])
        width = max(width, image.shape[1])
        if index in shown:
            kept[index] = image.copy()
    table = np.stack(found)
    tracks = [choose.best(t, table[:, index], width)[0][:, :2] for index in range(len(ranges))]
    proposals = [_proposal(recording, t, track, one) for track, one in zip(tracks, ranges, strict=True)]
    order = sorted(range(len(ranges)), key=lambda k: _rank(proposals[k], tracks[k], effector_uv))
    return tuple(proposals[k] for k in order), _sheet(kept, [tracks[k] for k in order])


def _picked(recording: Recording) -> Callable[[], Iterator[tuple[float, Array]]]:
    """Times and pictures, evenly picked, at most _LOOKED_AT of them, decoded one by one; what cannot be is left out."""
    frames = recording.frames or (lambda: iter(()))
    every = -(-sum(1 for _ in frames()) // _LOOKED_AT)

    def pictures() -> Iterator[tuple[float, Array]]:
        for frame in (frame for index, frame in enumerate(frames()) if index % every == 0):
            try:
                image = frame.decode(1)
            except FormatError:
                continue
            yield frame.t, image

    return pictures


def _none(recording: Recording) -> str:
    """Why there are no pictures: there are none, or the first cannot be decoded."""
    for frame in recording.frames() if recording.frames else ():
        try:
            frame.decode(1)
        except FormatError as problem:
            return f"no picture can be decoded: {problem}"
    return "no pictures to take colours from"


def _peaks(images: Iterable[Array]) -> list[int]:
    """The peaks of the pictures' hue histogram over saturated pixels, each holding a notable share of all pixels."""
    counts, pixels = np.zeros(180), 0
    for image in images:
        some, of = hues(image)
        counts, pixels = counts + some, pixels + of
    smooth = np.convolve(np.concatenate([counts[-_WIDTH:], counts, counts[:_WIDTH]]), np.ones(2 * _WIDTH + 1), "valid")
    peaks: list[int] = []
    for hue in np.argsort(-smooth, kind="stable").tolist():
        apart = all(abs((hue - other + 90) % 180 - 90) > 2 * _WIDTH for other in peaks)
        if apart and smooth[hue] >= _SHARE * pixels:
            peaks.append(hue)
    return peaks


def _range(hue: int) -> Range:
    return between(((hue - _WIDTH) % 180, SATURATION, VALUE), ((hue + _WIDTH) % 180, 255, 255))


def _proposal(recording: Recording, t: Array, track: Array, colour: Range) -> Proposal:
    seen = np.isfinite(track[:, 0])
    strays = float(np.hypot(*track[seen].std(axis=0))) if seen.any() else 0.0
    low, high = colour.parts[0][0], colour.parts[-1][1]
    name = nearest((low[0] + ((high[0] - low[0]) % 180) / 2) % 180)
    return Proposal(name, low, high, float(seen.mean()), strays, _explained(recording, t[seen], track[seen]))


def _explained(recording: Recording, t: Array, track: Array) -> float:
    """The share of a track's variance that a quadratic form of the joints explains."""
    joints = recording.joints
    if joints is None or len(t) < 4 or float(track.var(axis=0).sum()) < 1.0:
        return 0.0
    known = [(joints.t[there], column[there]) for column in joints.values.T if (there := np.isfinite(column)).any()]
    q = [np.interp(t, at, angle) for at, angle in known if angle.std() > 1e-2]
    design = np.column_stack([np.ones(len(t)), *q, *(angle**2 for angle in q)])
    if len(t) < 3 * design.shape[1]:
        return 0.0
    rest = track - design @ np.linalg.lstsq(design, track, rcond=None)[0]
    return float(np.clip(1 - rest.var(axis=0).sum() / track.var(axis=0).sum(), 0.0, 1.0))


def _rank(proposal: Proposal, track: Array, effector_uv: tuple[float, float] | None) -> tuple[float, float]:
    """Smaller is likelier: by distance from where the effector is said to be, or by motion with the joints."""
    seen = track[np.isfinite(track[:, 0])]
    if effector_uv is not None:
        away = float(np.hypot(*(seen[0] - effector_uv))) if len(seen) else np.inf
        return away, -proposal.joints
    return -proposal.joints * proposal.seen, -proposal.strays


def _sheet(images: Mapping[int, Array], tracks: list[Array]) -> Array:
    """The pictures {index: (H,W,3)} in two rows, with a numbered circle where each proposal was found."""
    import cv2

    size = np.max([image.shape for image in images.values()], axis=0)
    images = {index: _within(image, size) for index, image in images.items()}
    for index, image in images.items():
        for number, track in enumerate(tracks):
            if np.isfinite(track[index]).all():
                u, v = np.rint(track[index]).astype(int).tolist()
                cv2.circle(image, (u, v), 14, (255, 255, 255), 2, cv2.LINE_AA)
                cv2.putText(image, str(number + 1), (u + 16, v), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1)
    shown = list(images.values())
    shown += [np.zeros_like(shown[0])] * (len(shown) % 2)
    half = len(shown) // 2
    return np.vstack([np.hstack(shown[:half]), np.hstack(shown[half:])])


def _within(image: Array, size: Array) -> Array:
    """The picture in the upper left corner of a black one of that size (H,W,3)."""
    whole = np.zeros(size, np.uint8)
    whole[: image.shape[0], : image.shape[1]] = image
    return whole
