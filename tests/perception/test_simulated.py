"""Perception against the truth that simulated logs carry, over several seeds."""

from pathlib import Path

import numpy as np
import pytest

from bodylog.perception import observe
from bodylog.settings import Settings
from bodylog.types import Array

SEEDS = range(5)


def _truth(path: Path) -> dict[str, list[tuple[float, object]]]:
    """Messages of /truth topics with their stamps in s."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found: dict[str, list[tuple[float, object]]] = {}
    with path.open("rb") as stream:
        for _, channel, _, message in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            if channel.topic.startswith("/truth/"):
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                found.setdefault(channel.topic, []).append((stamp, message))
    return found


@pytest.mark.soak
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("scenario", "image"), [("reach", "jpeg"), ("reach", "raw"), ("touch", "jpeg")])
def test_tracks_touches_and_delays_are_as_simulated(scenario: str, image: str, seed: int, tmp_path: Path) -> None:
    pytest.importorskip("pybullet")
    from bodylog import sim
    from bodylog.logs.recording import read

    path = tmp_path / "log.mcap"
    sim.record(scenario, path, seed=seed, duration=12.0, image=image)
    recording = read(path, Settings())
    features, truth = observe(recording, Settings()), _truth(path)
    for name in ("effector", "hand"):
        pixels = truth.get(f"/truth/{name}_pixel", [])
        true = {stamp - recording.start_ns: (message.point.x, message.point.y) for stamp, message in pixels}
        if true:
            _compare(features.tracks[name].t, features.tracks[name].values, true)
    touched, stroked = truth.get("/truth/touch", []), truth.get("/truth/stroke", [])
    assert features.touches is not None and len(features.touches) == len(touched)
    for touch, (stamp, message) in zip(features.touches, touched, strict=True):
        assert touch.onset == pytest.approx((stamp - recording.start_ns) / 1e9, abs=0.015)
        length = message.duration.sec + message.duration.nanosec / 1e9
        assert touch.offset == pytest.approx((stamp - recording.start_ns) / 1e9 + length, abs=0.015)
    for pair, (_, message) in zip(features.synchrony, stroked, strict=True):
        assert pair.delay == pytest.approx(message.delay, abs=1 / 20) and pair.weight > 0.8


def _compare(t: Array, values: Array, true: dict[int, tuple[float, float]]) -> None:
    stamps = np.array(sorted(true))
    near = np.abs(stamps[:, None] - t * 1e9).argmin(axis=0)
    in_view = np.abs(stamps[near] - t * 1e9) < 1e5
    found = np.isfinite(values[:, 0])
    assert not (found & ~in_view).any()
    assert (found & in_view).sum() >= 0.985 * in_view.sum()
    errors = np.hypot(*(values - np.array([true[stamp] for stamp in stamps.tolist()])[near])[found].T)
    assert np.median(errors) <= 0.15 and np.quantile(errors, 0.99) <= 0.7
