"""A video whose images are shown later: packets are copied, nothing is encoded again."""

from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...io.extras import require_module
from ..limits import Input
from . import video

_TOLERANCE_S = 1e-4
"""s: LeRobot rejects images that are further from their rows."""


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
