"""Read videos frame by frame: times and images; MP4 tables are counted before they are opened."""

import mmap
import re
import struct
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, LogError
from ...io.extras import require_module
from ..limits import Input
from ..records import Array
from . import video

_LEAST_PIXELS = 1 << 20
"""A decoder pads small images, so that it needs more than these have."""
SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi")
_TOLERANCE_S = 1e-4
"""s: LeRobot rejects images that are further from their rows."""
_CONTAINERS = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"moof", b"traf", b"mvex")
_BOXES_A_FRAME = 4
_TRACKS = 4
"""Samples for each image: sound has some fifty a second where images are thirty."""
_MOST_BOXES = 1000
"""Boxes of a file, apart from those of fragments."""
_DEEPEST = 8


@dataclass(frozen=True, eq=False)
class Video:
    """One video: presentation times pts (K,) int64, ascending,
    in units of `base` s · width, height px · codec.
    """

    path: Path
    pts: Array
    base: float
    width: int
    height: int
    codec: str

    @property
    def t(self) -> Array:
        """Times of the frames (K,) s."""
        return self.pts * self.base


def survey_video(path: Path, limits: Input) -> Video:
    """Size, codec and frame times of a video, read from the packets' headers without decoding.

    LogError for a file that is not a video, or whose images are too large or too many.
    """
    mpx = limits.max_image_mpx
    check_samples(path, limits)
    with _open_video_stream(path) as (container, stream):
        width = stream.codec_context.width
        height = stream.codec_context.height
        if not 0 < width * height <= mpx * 1e6:
            raise LogError(
                f"{path}: images of {width} x {height}; set [input] max_image_mpx to read "
                "larger ones"
            )
        shown = array("q")
        with suppress(*_ffmpeg_damage_errors(path)):  # a truncated file has fewer packets
            for packet in container.demux(stream):
                if (
                    packet.size
                    and (at := packet.dts if packet.pts is None else packet.pts) is not None
                ):
                    shown.append(at)
                if len(shown) > limits.max_frames:
                    asked = f"type in robot.toml: [input] max_frames = {10 * limits.max_frames}"
                    raise LogError(
                        f"{path}: more than {limits.max_frames} images; to read them, {asked}"
                    )
        pts = np.sort(np.array(shown, np.int64))
        return Video(
            path, pts, float(stream.time_base or 0), width, height, stream.codec_context.name
        )


def iterate_video_images(
    video: Video, first: int = 0, last: int | None = None, grey: bool = False
) -> Iterator[tuple[int, Array | None]]:
    """Frames `first` to before `last` by number, each with its image (H,W,3) uint8 BGR; None if it
    is undecodable.

    `grey`: images (H,W) uint8 of their luminance.
    """
    due = first
    last = len(video.pts) if last is None else last
    for number, image in _decode_frames(video, first, _frame_luminance if grey else _frame_to_bgr):
        if number >= last:
            break
        if number < due:
            continue
        yield from ((missing, None) for missing in range(due, number))
        yield number, image
        due = number + 1
    yield from ((missing, None) for missing in range(due, last))


def _frame_to_bgr(frame: Any) -> Array:
    return np.asarray(frame.to_ndarray(format="bgr24"))


def _frame_luminance(frame: Any) -> Array:
    """A frame's luminance (H,W) uint8 from 0 to 255; planes of 8 bits are taken as they are,
    without conversion."""
    import cv2

    if not _PLANAR.fullmatch(frame.format.name):
        return np.asarray(cv2.cvtColor(_frame_to_bgr(frame), cv2.COLOR_BGR2GRAY))
    plane = frame.planes[0]
    rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    luminance = rows[: frame.height, : frame.width]
    full = frame.format.name.startswith("yuvj") or frame.color_range == _FULL_RANGE
    return np.ascontiguousarray(luminance) if full else np.asarray(cv2.LUT(luminance, _EXPANDED))


_PLANAR = re.compile(r"yuvj?4[0-4][0-4]p|nv12|nv21")


_FULL_RANGE = 2
"""AVCOL_RANGE_JPEG: luminance from 0 to 255."""


_EXPANDED = np.clip(np.rint((np.arange(256) - 16) * 255.0 / 219.0), 0, 255).astype(np.uint8)
"""Luminance from 0 to 255 by that from 16 to 235 (ITU-R BT.601)."""


def _decode_frames(
    video: Video, first: int, convert: Callable[[Any], Array]
) -> Iterator[tuple[int, Array]]:
    """Frames with their numbers, from a key frame at or before `first` on; none where data are
    damaged, or an image has more pixels than the video states."""
    known = {pts: number for number, pts in reversed(list(enumerate(video.pts.tolist())))}
    if not known:
        return
    with (
        _open_video_stream(video.path) as (container, stream),
        suppress(*_ffmpeg_damage_errors(video.path)),
    ):
        stream.codec_context.options = {
            "max_pixels": str(max(video.width * video.height, _LEAST_PIXELS))
        }
        if first:
            container.seek(int(video.pts[first]), stream=stream, backward=True)
        number = -1
        for frame in _sound_frames(container, stream, video.path):
            number = max(known.get(frame.pts, number + 1), number + 1)
            if (frame.width, frame.height) == (video.width, video.height):
                yield number, convert(frame)


def _sound_frames(container: Any, stream: Any, path: Path) -> Iterator[Any]:
    """What a decoder makes of each packet; nothing of one that it rejects."""
    for packet in container.demux(stream):
        with suppress(*_ffmpeg_damage_errors(path)):
            yield from packet.decode()


@contextmanager
def _open_video_stream(path: Path) -> Iterator[tuple[Any, Any]]:
    """The container and its first video stream; LogError without one.

    The file's first bytes select the format, so that
    FFmpeg reads no text as a list of other files or URLs.
    """
    av = require_module("av", path)
    with path.open("rb") as file:
        form = _video_container_form(file.read(12))
    if form is None:
        raise LogError(f"{path}: no video: its first bytes are those of no MP4, Matroska or AVI")
    try:
        container = av.open(str(path), format=form, options={"protocol_whitelist": "file"})
    except _ffmpeg_damage_errors(path) as problem:
        raise LogError(
            f"{path}: the video cannot be opened, it may be cut: {_error_line(problem)}"
        ) from None
    with container:
        if not container.streams.video:
            raise LogError(f"{path}: the file holds no video")
        if container.streams.video[0].codec_context is None:
            raise LogError(f"{path}: the video's codec is unknown; is the file damaged?")
        yield container, container.streams.video[0]


def is_video(first: bytes) -> bool:
    """Whether a file that begins with these bytes is a readable video."""
    return _video_container_form(first) is not None


def _video_container_form(first: bytes) -> str | None:
    if first[4:8] in (b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip"):
        return "mp4"
    if first[:4] == b"\x1aE\xdf\xa3":
        return "matroska"
    return "avi" if first[:4] == b"RIFF" and first[8:12] == b"AVI " else None


def _ffmpeg_damage_errors(path: Path) -> tuple[type[Exception], ...]:
    """Exceptions of FFmpeg's binding for damaged files."""
    return (require_module("av", path).error.FFmpegError, ValueError, EOFError)


def _error_line(problem: BaseException) -> str:
    return " ".join(str(problem).split())[:160]


def write_later(source: Path, out: Path, later_s: float) -> None:
    """Write a video (.mp4) with the packets of another one, each shown `later_s` >= 0 s later.

    FormatError where the result does not show the same frames at these times.
    """
    av = require_module("av", source)
    with av.open(str(source)) as before, av.open(str(out), "w", format="mp4") as after:
        stream = before.streams.video[0]
        copied = after.add_stream_from_template(stream)
        shift = round(later_s / float(stream.time_base))
        for packet in before.demux(stream):
            if packet.dts is None:
                continue
            packet.pts += shift
            packet.dts += shift
            packet.stream = copied
            after.mux(packet)
    limits = Input(max_frames=1 << 31)
    first, second = (video.survey_video(path, limits).t for path in (source, out))
    if len(first) != len(second) or np.abs(second - first - later_s).max(initial=0) > _TOLERANCE_S:
        raise FormatError(f"{source}: its packets cannot be shown {later_s:g} s later")


def check_samples(path: Path, limits: Input) -> None:
    """LogError where an MP4 declares more samples than a camera may have images; others pass."""
    if path.stat().st_size < 16:
        return
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[4:8] not in (b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip"):
            return
        samples = 0
        parts = 0
        for boxes, (kind, start, end) in enumerate(_iterate_boxes(data, 0, len(data), 0)):
            if kind in (b"stsz", b"stz2") and end - start >= 12:
                samples += struct.unpack_from(">I", data, start + 8)[0]
            elif kind == b"trun" and end - start >= 8:
                samples += struct.unpack_from(">I", data, start + 4)[0]
            elif kind == b"elst" and end - start >= 8:
                parts = max(parts, struct.unpack_from(">I", data, start + 4)[0])
            whole = samples * max(parts, 1)
            if (
                whole > _TRACKS * limits.max_frames
                or boxes > _BOXES_A_FRAME * limits.max_frames + _MOST_BOXES
            ):
                asked = f"to read it, type in robot.toml: [input] max_frames = {max(whole, boxes)}"
                raise LogError(
                    f"{path}: its tables declare {whole} samples in {boxes} boxes; {asked}"
                )


def _iterate_boxes(
    data: mmap.mmap, start: int, end: int, depth: int
) -> Iterator[tuple[bytes, int, int]]:
    """Every box between two bytes, and those in it:
    its kind, and where its content begins and ends.
    """
    while start + 8 <= end:
        length, kind = struct.unpack_from(">I4s", data, start)
        head = 8
        if length == 1 and start + 16 <= end:
            length = struct.unpack_from(">Q", data, start + 8)[0]
            head = 16
        last = end if length == 0 else min(start + length, end)
        if last < start + head:
            return
        yield kind, start + head, last
        if kind in _CONTAINERS and depth < _DEEPEST:
            yield from _iterate_boxes(data, start + head, last, depth + 1)
        start = last
