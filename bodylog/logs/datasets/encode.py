"""Encode images as a video file with given frame times, and measure the error of the result."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from ...errors import LogError, UsageError
from ...io.extras import require_module
from ...runtime.blas_threads import without_real_time
from ..limits import Input
from ..records import Array
from . import video

Images = Callable[[], Iterator[Array]]
"""Returns the images (H,W,3) uint8 BGR of a video in order, on each call."""
_TICKS = 1_000_000
"""Per second: times of frames are kept to the microsecond."""


@dataclass(frozen=True)
class Codec:
    """An encoder of FFmpeg: its name, pixel format, options, and the format's name in info.json."""

    encoder: str
    pixels: str
    options: Mapping[str, str]
    name: str


CODECS: Mapping[str, Codec] = {
    "lossless": Codec(
        "libx264rgb", "bgr24", {"qp": "0", "preset": "veryfast", "g": "10", "bf": "0"}, "h264"
    ),
    "h264": Codec(
        "libx264", "yuv420p", {"crf": "18", "preset": "veryfast", "g": "10", "bf": "0"}, "h264"
    ),
    "av1": Codec("libsvtav1", "yuv420p", {"crf": "30", "preset": "8", "g": "2"}, "av1"),
}
"""The choices of --codec; av1 as LeRobot writes it (crf 30, a key frame every 2 frames)."""


def find_codec(name: str) -> Codec:
    """The encoder of that name; UsageError lists the choices."""
    if name not in CODECS:
        raise UsageError(f"--codec {name}: possible are {', '.join(CODECS)}")
    return CODECS[name]


def encode_video(path: Path, how: Codec, images: Images, t: Array, size: tuple[int, int]) -> float:
    """Write a video of the images, frame k shown at t[k]
    (N,) s, and return its RMS error in grey levels.

    LogError if the images differ in size, or the video does not hold what was written.
    """
    width, height = size
    if how.pixels == "yuv420p" and (width % 2 or height % 2):
        raise UsageError(
            f"images of {width} x {height}: this codec needs even sides; type: --codec lossless"
        )
    pts = np.rint(t * _TICKS).astype(np.int64)
    if (np.diff(pts) <= 0).any():
        raise LogError(f"{path.name}: two images within one microsecond")
    _write_encoded_video(path, how, images, pts, size)
    return _measure_coding_error(path, images, pts, size)


def _write_encoded_video(
    path: Path, how: Codec, images: Images, pts: Array, size: tuple[int, int]
) -> None:
    av = require_module("av", path)
    if how.encoder not in av.codecs_available:
        raise UsageError(
            f"{path.name}: this PyAV has no {how.encoder}; type: pip install -U av, or "
            "another --codec"
        )
    with av.open(str(path), "w", format="mp4", options={"fflags": "+bitexact"}) as container:
        stream = container.add_stream(
            how.encoder, rate=Fraction(_TICKS, _median_tick_step(pts)), options=dict(how.options)
        )
        stream.width, stream.height = size
        stream.pix_fmt = how.pixels
        stream.time_base = Fraction(1, _TICKS)
        stream.codec_context.time_base = Fraction(1, _TICKS)
        try:
            with without_real_time():
                stream.codec_context.open()
            for at, image in zip(pts.tolist(), images(), strict=True):
                frame = av.VideoFrame.from_ndarray(
                    _fit_image_size(image, size, path), format="bgr24"
                )
                frame.pts = at
                frame.time_base = Fraction(1, _TICKS)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
        except av.error.FFmpegError as problem:
            text = (
                f"{how.encoder} refuses images of {size[0]} x {size[1]} ({problem}); type: "
                "--codec lossless"
            )
            raise UsageError(f"{path.name}: {text}") from None


def _median_tick_step(pts: Array) -> int:
    """The median time between frames, in ticks."""
    return max(int(np.median(np.diff(pts))), 1) if len(pts) > 1 else _TICKS


def _fit_image_size(image: Array, size: tuple[int, int], path: Path) -> Array:
    height, width = image.shape[:2]
    if (width, height) != size:
        raise LogError(
            f"{path.name}: images of {size[0]} x {size[1]} and of {width} x {height}; a "
            "video has one size"
        )
    return np.ascontiguousarray(image)


def _measure_coding_error(path: Path, images: Images, pts: Array, size: tuple[int, int]) -> float:
    """RMS difference (grey levels) of the video's frames
    from the images; LogError where frames are missing.
    """
    found = video.survey_video(
        path, Input(max_image_mpx=size[0] * size[1] / 1e6, max_frames=max(len(pts), 1))
    )
    shown = np.rint(found.t * _TICKS).astype(np.int64)
    if len(shown) != len(pts) or np.abs(shown - pts).max(initial=0) > 1:
        raise LogError(
            f"{path.name}: was not written correctly: {len(shown)} frames where {len(pts)} "
            "were written"
        )
    total = 0.0
    for (number, image), wanted in zip(video.iterate_video_images(found), images(), strict=True):
        if image is None:
            raise LogError(
                f"{path.name}: was not written correctly: frame {number} cannot be read back"
            )
        total += (
            float(np.mean((image.astype(np.int16) - wanted) ** 2.0))
            if not np.array_equal(image, wanted)
            else 0.0
        )
    return float(np.sqrt(total / max(len(pts), 1)))
