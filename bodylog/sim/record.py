"""Play a scenario and write what its sensors see, and the truth beside it, as an ordinary ROS 2 MCAP."""

import heapq
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .. import files
from ..errors import UsageError
from .arms import ARMS
from .film import camera_items, side_items
from .plan import Plan, Request, choose, unknown
from .scenarios import SCENARIOS
from .stage import Stage, Wish, open_stage
from .streams import encoder_items, event_items, skin_items

_IMAGES = ("jpeg", "raw")
_CHUNK_BYTES = 1 << 18
"""Small chunks: a log cut short by a crash loses little."""


def record(
    scenario: str,
    out: Path,
    seed: int = 0,
    duration: float | None = None,
    image: str = "jpeg",
    size: tuple[int, int] = (640, 480),
    noise: float | None = None,
    full: bool = False,
    arm: str = "ur5",
    variant: str | None = None,
    place: str | None = None,
    marker: bool = False,
    cameras: int = 1,
    turning: bool = False,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Write `scenario` to `out`, the same bytes for the same arguments; UsageError when one of them is not possible.

    duration (s), noise (encoders, rad), variant and place are the scenario's own when None; size in px; `marker` puts
    a blue ball on the arm, for a second visual sense; `cameras` is 2 for one at the side beside the head's, `turning`
    turns the head as one more joint; `progress` is told how many more pictures the head's has taken.
    """
    plan, length = _plan(scenario, seed, duration, full, arm, variant, place)
    if image not in _IMAGES:
        raise UsageError(f"{unknown('image', image, _IMAGES)}; type: --image jpeg")
    _check("width", size[0], 64, 4096)
    _check("height", size[1], 48, 4096)
    wished = plan.noise if noise is None else noise
    _check("noise", wished, 0.0, 10.0)
    _check("cameras", cameras, 1, 2)
    wish = Wish(scenario, ARMS[arm], plan, length, seed, size, wished, image, marker, cameras, turning)
    with files.replacing(out) as beside, open_stage(wish) as stage:
        _write(beside, stage, progress)


def _plan(
    scenario: str, seed: int, duration: float | None, full: bool, arm: str, variant: str | None, place: str | None
) -> tuple[Plan, float]:
    if scenario not in SCENARIOS:
        raise UsageError(f"{unknown('scenario', scenario, SCENARIOS)}; type: bodylog record babble -o babble.mcap")
    if arm not in ARMS:
        raise UsageError(f"{unknown('arm', arm, ARMS)}; type: --arm ur5")
    _check("seed", seed, 0, 2**63)
    entry = SCENARIOS[scenario]
    length = entry.duration if duration is None else duration
    _check("duration", length, 0.1, 86400.0)
    variant = choose(scenario, "variant", variant, entry.variants)
    place = choose(scenario, "place", place, entry.places)
    request = Request(ARMS[arm], length, full, variant, place, np.random.default_rng([seed, 0]))
    return entry.plan(request), length


def _check(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise UsageError(f"{name} is {value}; possible: {low} to {high:g}; type: --{name} with such a number")


def _write(path: Path, stage: Stage, progress: Callable[[int], None] | None) -> None:
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="bodylog")
        writer.add_metadata("bodylog_simulation", _settings(stage.wish))
        _fill(writer, stage, progress)
        writer.finish()  # type: ignore[no-untyped-call]


def _fill(writer: Any, stage: Stage, progress: Callable[[int], None] | None) -> None:
    from .messages import store

    channels: dict[str, tuple[int, int]] = {}
    streams = (encoder_items, skin_items, camera_items, side_items, event_items)
    for item in heapq.merge(*(stream(stage) for stream in streams), key=lambda item: item.log_ns):
        kind = item.message.__msgtype__
        if item.topic not in channels:
            channels[item.topic] = (_channel(writer, item.topic, kind), 0)
        channel, count = channels[item.topic]
        channels[item.topic] = (channel, count + 1)
        payload = bytes(store().serialize_cdr(item.message, kind))
        writer.add_message(channel, item.log_ns, payload, item.stamp_ns, count)
        if progress is not None and item.topic == stage.image_topic:
            progress(1)


def _channel(writer: Any, topic: str, kind: str) -> int:
    from .messages import definition

    schema = writer.register_schema(kind, "ros2msg", definition(kind))
    return int(writer.register_channel(topic, "cdr", schema))


def _settings(wish: Wish) -> dict[str, str]:
    seen = ({"cameras": str(wish.cameras)} if wish.cameras > 1 else {}) | ({"turning": "true"} if wish.turning else {})
    return seen | {
        "scenario": wish.scenario,
        "seed": str(wish.seed),
        "duration_s": repr(wish.duration),
        "image": wish.image,
        "size": "x".join(str(side) for side in wish.size),
        "noise_rad": repr(wish.noise),
        "arm": wish.arm.urdf.stem,
        "marker": str(wish.marker).lower(),
    }
