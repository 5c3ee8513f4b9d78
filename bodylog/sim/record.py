"""Play a scenario and write its sensors' messages, and the truth, as an ordinary ROS 2 MCAP."""

import heapq
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UsageError
from ..io import atomic_files
from ..logs.conversion.transcode import LIBRARY, PROFILE
from ..logs.mcap.writer import Contents, McapRecordWriter
from ..logs.protocol import Progress
from .arms import ARMS
from .film import camera_items, side_items
from .hardware import parse_hardware
from .joint_motion import move_joints
from .options import Options, check_camera, check_options, require_within
from .plan import Request, ScenarioPlan, choose_or_default, describe_unknown_name
from .scenarios import SCENARIOS
from .stage import Stage, Wish, open_stage
from .streams import encoder_items, event_items, other_items, skin_items


def record_scenario(
    scenario: str, out: Path, *, progress: Progress | None = None, **options: Any
) -> None:
    """Write `scenario` to `out`, the same bytes for the
    same `options` (see Options), or raise UsageError.

    `progress` is called with 1 after each image of the first camera.
    """
    asked = Options(**options)
    plan, length = _plan_scenario(scenario, asked)
    check_options(asked)
    check_camera(scenario, plan, asked)
    wished = plan.noise if asked.noise is None else asked.noise
    require_within("noise", wished, 0.0, 10.0)
    hardware = parse_hardware(asked.hardware)
    arm = ARMS[asked.arm]
    joints = move_joints(plan.motion, hardware, arm, length)
    wish = Wish(
        scenario, asked, arm, replace(plan, motion=joints.links), length, wished, hardware, joints
    )
    with atomic_files.replace_atomically(out) as beside, open_stage(wish) as stage:
        _write_recording(beside, stage, progress)


def _plan_scenario(scenario: str, options: Options) -> tuple[ScenarioPlan, float]:
    if scenario not in SCENARIOS:
        raise UsageError(
            f"{describe_unknown_name('scenario', scenario, SCENARIOS)}; type: bodylog record "
            "babble -o babble.mcap"
        )
    if options.arm not in ARMS:
        raise UsageError(f"{describe_unknown_name('arm', options.arm, ARMS)}; type: --arm ur5")
    require_within("seed", options.seed, 0, 2**63)
    entry = SCENARIOS[scenario]
    length = entry.duration if options.duration is None else options.duration
    require_within("duration", length, 0.1, 86400.0)
    variant = choose_or_default(scenario, "variant", options.variant, entry.variants)
    place = choose_or_default(scenario, "place", options.place, entry.places)
    request = Request(
        ARMS[options.arm],
        length,
        options.full,
        variant,
        place,
        np.random.default_rng([options.seed, 0]),
    )
    return entry.plan(request), length


def _write_recording(path: Path, stage: Stage, progress: Progress | None) -> None:
    with path.open("wb") as stream:
        writer = McapRecordWriter(stream, Contents())
        writer.begin(PROFILE, LIBRARY)
        writer.about("bodylog_simulation", _recording_metadata(stage.wish))
        _write_streams(writer, stage, progress)
        writer.finish()


def _write_streams(writer: McapRecordWriter, stage: Stage, progress: Progress | None) -> None:
    from .messages import message_definition, type_store

    channels: dict[str, int] = {}
    counts: Counter[str] = Counter()
    streams = (encoder_items, other_items, skin_items, camera_items, side_items, event_items)
    for item in heapq.merge(*(stream(stage) for stream in streams), key=lambda item: item.log_ns):
        topic = item.topic
        kind = item.message.__msgtype__
        if topic not in channels:
            definition = message_definition(kind)
            channels[topic] = writer.topic(topic, kind, "cdr", definition, "ros2msg", {})
        payload = type_store().serialize_cdr(item.message, kind)
        writer.add_message(
            channels[topic], counts[topic], item.log_ns, item.stamp_ns, bytes(payload)
        )
        counts[topic] += 1
        if progress is not None and topic == stage.image_topic:
            progress(1)


def _recording_metadata(wish: Wish) -> dict[str, str]:
    """The log's metadata about its recording; newer options only where they are used."""
    options = wish.options
    usual = Options()
    newer = (
        "cameras",
        "turning",
        "feature",
        "feature_size",
        "clutter",
        "split_joints",
        "camera",
        "hardware",
        "scene",
    )
    used = {
        name: getattr(options, name)
        for name in newer
        if getattr(options, name) != getattr(usual, name)
    }
    return {name: str(value).lower() for name, value in used.items()} | {
        "scenario": wish.scenario,
        "seed": str(options.seed),
        "duration_s": repr(wish.duration),
        "image": options.image,
        "size": "x".join(str(side) for side in options.size),
        "noise_rad": repr(wish.noise),
        "arm": wish.arm.urdf.stem,
        "marker": str(options.marker).lower(),
    }
