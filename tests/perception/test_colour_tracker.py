"""Tracks against drawn discs and against logs with truth."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from threading import active_count

import numpy as np
import pytest

from bodylog.errors import ConfigError, FormatError
from bodylog.perception import observe_recording
from bodylog.perception.colours import blob_measurement, hsv_ranges
from bodylog.settings import Colour, ColourSettings, Settings
from bodylog.types import Array, Health, LazyImage, Series
from tests.changed_recordings import change_recording
from tests.perception import scenes
from tests.perception.scenes import Disc, track_colours
from tests.seeds import first_of

SHARED = Path(__file__).parents[2].parent / "shared" / "logs"
T = np.arange(60) / 20.0
PATH = np.column_stack([160.0 + 70.0 * np.sin(1.7 * T), 120.0 + 50.0 * np.cos(1.3 * T)])


def _film(discs: Sequence[Sequence[Disc]], seed: int, width: int = 320, height: int = 240) -> list[Array]:
    rng = np.random.default_rng(seed)
    wall = scenes.wall(rng, width, height, contrast=4.0)
    return [scenes.jpeg(scenes.draw(wall, each, rng)) for each in discs]


def _raw(discs: Sequence[Sequence[Disc]], seed: int) -> Callable[[], Iterator[LazyImage]]:
    rng = np.random.default_rng(seed)
    wall = scenes.wall(rng, contrast=4.0)
    return _plain([scenes.draw(wall, each, rng) for each in discs])


def _plain(pictures: Sequence[Array]) -> Callable[[], Iterator[LazyImage]]:
    return lambda: (LazyImage(t, round(t * 1e9), lambda _, p=p: p) for t, p in zip(T.tolist(), pictures, strict=False))


def _track(discs: Sequence[Sequence[Disc]], seed: int, name: str = "green") -> tuple[Series, Health]:
    pictures = scenes.frames(T[: len(discs)], _film(discs, seed))
    tracks, health, _ = track_colours(pictures, {"it": name})
    return tracks["it"], health["it"]


def _errors(track: Series, truth: Array) -> Array:
    return np.hypot(*(track.values - truth[: len(track.t)]).T)


@pytest.mark.parametrize("seed", range(5))
def test_colour_track_is_exact_to_a_tenth_pixel(seed: int) -> None:
    track, health = _track([[Disc(u, v, 5.5)] for u, v in PATH], seed)
    errors = _errors(track, PATH)
    assert health.used == len(T)
    assert np.median(errors) < 0.15
    assert errors.max() < 0.7


@pytest.mark.parametrize(("radius", "colour_name", "raw"), first_of(3, [
    (5.5, "green", False), (9.0, "red", True), (22.0, "green", False),
    (5.5, "green", True), (9.0, "red", False), (22.0, "green", True),
]))  # fmt: skip
def test_stated_deviation_is_the_true_one_within_a_third(radius: float, colour_name: str, raw: bool) -> None:
    paint = {"green": scenes.GREEN, "red": scenes.RED}[colour_name]
    true, stated = [], []
    for seed in range(3):
        discs = [[Disc(u, v, radius, paint)] for u, v in PATH]
        pictures = _raw(discs, seed) if raw else scenes.frames(T, _film(discs, seed))
        track = track_colours(pictures, {"it": colour_name})[0]["it"]
        assert track.std is not None and np.isfinite(track.std).all()
        true.append(((track.values - PATH) ** 2).mean())
        stated.append((track.std**2).mean())
    assert 0.7 < np.sqrt(np.mean(stated) / np.mean(true)) < 1.3


@pytest.mark.parametrize("raw", [False, True])
def test_stated_deviation_is_the_true_one_over_many_places_a_target_stands_still_at(raw: bool) -> None:
    # in one place the error hardly changes: it is one draw, of which the stated deviation is the expectation
    rng = np.random.default_rng(1)
    true, stated = [], []
    for place in 64.0 + rng.uniform(-8.0, 8.0, (40, 2)):
        wall, disc = scenes.wall(rng, 128, 128, contrast=4.0), Disc(*place.tolist(), 9.0)
        pictures = [scenes.draw(wall, [disc], rng) for _ in range(8)]
        film = _plain(pictures) if raw else scenes.frames(T[:8], list(map(scenes.jpeg, pictures)))
        track = track_colours(film, {"it": "green"})[0]["it"]
        assert track.std is not None
        true.append(((track.values - place) ** 2).mean())
        stated.append((track.std**2).mean())
    assert 0.7 < np.sqrt(np.mean(stated) / np.mean(true)) < 1.3


def test_colour_track_is_exact_without_noise() -> None:
    rng = np.random.default_rng(0)
    wall = scenes.wall(rng, 96, 96, contrast=0.0)
    for u, v in 48.0 + rng.uniform(-4.0, 4.0, (20, 2)):
        image = scenes.draw(wall, [Disc(u, v, 20.0)], rng, noise=0.0)
        found = blob_measurement.measured_blobs([image], [hsv_ranges.resolve_colour("green", "it")])[0, 0, 0, :2]
        assert np.abs(found - (u, v)).max() < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_colour_track_at_half_scale_has_larger_deviations(seed: int) -> None:
    wide = 2 * PATH
    pictures = scenes.frames(T, _film([[Disc(u, v, 12.0)] for u, v in wide], seed, 640, 480))
    exact, fast = (track_colours(pictures, {"it": "green"}, fast=fast)[0]["it"] for fast in (False, True))
    assert exact.std is not None and fast.std is not None
    error = fast.values - wide
    assert np.median(_errors(exact, wide)) < np.median(np.hypot(*error.T)) < 0.15
    assert np.abs(error.mean(axis=0)).max() < 0.03
    assert 0.7 < np.sqrt((fast.std**2).mean() / (error**2).mean()) < 1.3


def test_pictures_that_do_not_shrink_are_seen_whole_at_any_scale() -> None:
    discs = [[Disc(u, v, 9.0)] for u, v in PATH]
    exact, fast = (track_colours(_raw(discs, 0), {"it": "green"}, fast=fast)[0]["it"] for fast in (False, True))
    assert exact.values.tobytes() == fast.values.tobytes()


@pytest.mark.parametrize("seed", range(3))
def test_shading_does_not_pull_the_centre(seed: int) -> None:
    wide = 2 * PATH
    discs = [[Disc(u, v, 14.0, scenes.GREEN, shade=0.25)] for u, v in wide]
    tracks, _, _ = track_colours(scenes.frames(T, _film(discs, seed, 640, 480)), {"it": "green"})
    assert np.median(_errors(tracks["it"], wide)) < 0.15


def test_hidden_is_nothing_and_counted() -> None:
    discs = [[] if 20 <= i < 35 else [Disc(u, v, 5.5)] for i, (u, v) in enumerate(PATH)]
    track, health = _track(discs, 0)
    assert np.isnan(track.values[20:35]).all()
    assert np.isfinite(track.values[:20]).all() and np.isfinite(track.values[35:]).all()
    assert health.rejected == {"hidden": 15}
    assert health.largest_gap_s == pytest.approx(16 / 20)


@pytest.mark.parametrize(("radius", "whole", "cut"), [(5.5, 6.5, 4.0), (10.0, 11.0, 7.5)])
def test_colour_track_rejects_blobs_at_the_border(radius: float, whole: float, cut: float) -> None:
    u = np.linspace(40.0, -8.0, 40)
    track, health = _track([[Disc(x, 120.0, radius)] for x in u], 0)
    assert np.isfinite(track.values[u > whole, 0]).all()
    assert np.isnan(track.values[u < cut, 0]).all()
    assert health.rejected["at the border"] > 0


@pytest.mark.parametrize("seed", range(3))
def test_partly_hidden_is_nothing_or_says_how_far_it_is_off(seed: int) -> None:
    grey = (110, 110, 110)
    discs = [[Disc(u, v, 8.0)] for u, v in PATH]
    for i, way in zip(range(25, 35), np.linspace(26.0, -10.0, 10), strict=True):
        discs[i].append(Disc(PATH[i, 0] + way, PATH[i, 1], 16.0, grey))
    track, health = _track(discs, seed)
    seen = np.isfinite(track.values[:, 0])
    assert health.rejected["partly hidden"] >= 1
    assert (_errors(track, PATH)[seen] < 0.7).all()


def test_colour_track_ignores_a_smaller_twin() -> None:
    twin = Disc(60.0, 60.0, 4.0)
    discs = [[twin] if 20 <= i < 35 else [twin, Disc(u, v, 8.0)] for i, (u, v) in enumerate(PATH)]
    track, health = _track(discs, 0)
    assert np.isnan(track.values[20:35]).all()
    assert health.used == 45
    assert _errors(track, PATH)[np.isfinite(track.values[:, 0])].max() < 0.7


def test_colour_track_ignores_an_equal_still_twin() -> None:
    twin = Disc(30.0, 30.0, 6.0)
    track, health = _track([[twin, Disc(u, v, 6.0)] for u, v in PATH], 0)
    assert health.used == len(T)
    assert _errors(track, PATH).max() < 0.7


def test_colour_track_rejects_two_equal_moving_candidates() -> None:
    other = np.column_stack([320.0 - PATH[:, 0], 240.0 - PATH[:, 1]])
    keep = np.hypot(*(other - PATH).T) > 30
    discs = [[Disc(u, v, 6.0), Disc(x, y, 6.0)] for (u, v), (x, y) in zip(PATH[keep], other[keep], strict=True)]
    track, health = _track(discs, 0)
    assert health.used == 0
    assert health.rejected["two candidates"] == len(discs)
    assert np.isnan(track.values).all()


def test_colour_track_follows_a_fast_target() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform([30, 30], [290, 210], (30, 2))
    _, health = _track([[Disc(u, v, 6.0)] for u, v in places], 0)
    assert health.used == 30


def test_observe_gives_a_track_per_named_feature() -> None:
    discs = [[Disc(u, v, 6.0), Disc(30.0, 30.0, 7.0, scenes.YELLOW)] for u, v in PATH[:10]]
    settings = Settings(colours=ColourSettings(markers={"elbow": "yellow"}))
    features = observe_recording(scenes.recording(scenes.frames(T[:10], _film(discs, 0))), settings)
    assert list(features.tracks) == list(features.health) == ["effector", "elbow"]  # no skin, so no hand is looked for
    assert np.allclose(features.tracks["elbow"].values, 30.0, atol=0.3)
    settings = replace(settings, colours=replace(settings.colours, hand="magenta"))
    named = observe_recording(scenes.recording(scenes.frames(T[:10], _film(discs, 0))), settings)
    assert named.hand is not None and np.isnan(named.hand.values).all()


def test_unseen_colour_is_named_with_the_colours_seen() -> None:
    pictures = scenes.frames(T[:5], _film([[Disc(100.0, 100.0, 15.0, scenes.YELLOW)]] * 5, 0))
    _, _, findings = track_colours(pictures, {"effector": "green"})
    (finding,) = findings
    assert finding.severity == "warning"
    assert "effector: 'green' was never found in 5 pictures; seen: yellow" in finding.text
    assert finding.text.endswith('; type: [colours] effector = "yellow"')


@pytest.mark.parametrize("other", ["yellow", {"low": (20, 90, 50), "high": (36, 255, 255)}])
def test_colour_of_another_feature_is_never_proposed(other: Colour) -> None:
    pictures = scenes.frames(T[:5], _film([[Disc(100.0, 100.0, 15.0, scenes.YELLOW)]] * 5, 0))
    _, _, findings = track_colours(pictures, {"effector": other, "hand": "red"})
    (finding,) = findings
    assert finding.text.startswith("hand: 'red' was never found in 5 pictures; seen: yellow")
    assert "type:" not in finding.text


def test_observe_reports_a_missing_camera_and_missing_images() -> None:
    features = observe_recording(scenes.recording(), Settings())
    assert not features.tracks and "camera: none" in features.findings[0].text
    empty = observe_recording(scenes.recording(lambda: iter(())), Settings())
    assert any("no picture" in finding.text for finding in empty.findings)
    assert empty.effector is not None and empty.effector.values.shape == (0, 2)


def test_undecodable_image_is_a_gap_and_a_loss() -> None:
    def broken(_: int) -> Array:
        raise FormatError("log.mcap: /camera: picture 3: not a JPEG")

    whole = list(scenes.frames(T[:9], _film([[Disc(u, v, 6.0)] for u, v in PATH[:9]], 0))())
    frames = [replace(frame, decode=broken) if i == 3 else frame for i, frame in enumerate(whole)]
    tracks, health, findings = track_colours(lambda: iter(frames), {"effector": "green"})
    assert health["effector"].rejected == {"undecodable picture": 1}
    assert np.isnan(tracks["effector"].values[3]).all()
    (lost,) = findings
    why = "the first for this: log.mcap: /camera: picture 3: not a JPEG"
    assert (lost.severity, lost.text) == ("lost", f"1 of 9 pictures could not be decoded, {why}")
    _, _, none = track_colours(lambda: (replace(frame, decode=broken) for frame in whole), {"effector": "green"})
    assert [finding.severity for finding in none] == ["lost"], "what was not looked at has no colour to propose"


def test_pictures_are_decoded_a_bounded_number_ahead_and_the_threads_end() -> None:
    payload = _film([[Disc(100.0, 100.0, 6.0)]], 0)[0]
    asked, done, furthest = [0], [0], [0]

    def source() -> "list[LazyImage]":
        for index in range(200):
            asked[0] = index + 1
            furthest[0] = max(furthest[0], asked[0] - done[0])
            yield scenes.frame(index / 30.0, payload)

    def count(more: int) -> None:
        done[0] += more

    before = active_count()
    track_colours(source, {"effector": "green"}, count)
    assert done[0] == 200
    assert furthest[0] <= 32
    assert active_count() == before


def test_same_pictures_same_bytes() -> None:
    film = _film([[Disc(u, v, 6.0)] for u, v in PATH], 0)
    first, second = (track_colours(scenes.frames(T, film), {"it": "green"})[0]["it"] for _ in range(2))
    assert first.values.tobytes() == second.values.tobytes()
    assert first.std is not None and second.std is not None and first.std.tobytes() == second.std.tobytes()


def test_unknown_colour_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"colours\.effector: found 'gren'; possible: red, .*type: effector = .green"):
        track_colours(lambda: iter(()), {"effector": "gren"})


@pytest.mark.parametrize("log", ["explore.mcap", "reach.mcap", "touch.mcap", "touch_async.mcap"])
def test_arm_logs_are_tracked_as_truth_has_it(log: str) -> None:
    from bodylog.recording.recording import read_recording

    path = SHARED / "arm" / log
    if not path.exists():
        pytest.skip(f"{path} is not here")
    truth = np.load(f"{path}.truth.npz")
    features = observe_recording(read_recording(path, Settings()), Settings())
    for name, key in {"effector": "ee", "hand": "hand"}.items():
        in_view = truth["seen"] if key == "ee" else np.isfinite(truth[key][:, 0])
        found = np.isfinite(features.tracks[name].values[:, 0])
        # the truth calls nothing within 12 px of the picture's edge in view, but the whole disc is there and is found
        near_edge = (np.minimum(truth[key], (319, 239) - truth[key]) < 12).any(axis=1)
        assert not (found & ~in_view & ~near_edge).any()
        if in_view.any():
            assert (found & in_view).sum() >= 0.995 * in_view.sum()
            errors = _errors(features.tracks[name], truth[key])[found]
            assert np.median(errors) <= 0.15 and np.quantile(errors, 0.99) <= 0.7


def test_measured_centre_ignores_bright_surroundings() -> None:
    rng = np.random.default_rng(0)
    errors = []
    for u, v in PATH:
        wall = scenes.wall(rng, contrast=4.0)
        wall[: round(v), round(u) - 8 : round(u) + 9] = 150.0
        image = scenes.draw(wall, [Disc(u, v, 9.0, scenes.RED)], rng)
        errors.append(blob_measurement.measured_blobs([image], [hsv_ranges.resolve_colour("red", "it")])[0, 0, 0, :2] - (u, v))
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02


def test_stated_deviation_holds_on_logs_of_a_moving_arm_and_hand() -> None:
    from bodylog.recording.recording import read_recording

    if not (SHARED / "arm").exists():
        pytest.skip(f"{SHARED / 'arm'} is not here")
    tried = [("explore.mcap", "effector", "ee"), ("drift.mcap", "effector", "ee"), ("touch.mcap", "hand", "hand")]
    for log, name, key in tried:
        truth = np.load(SHARED / "arm" / f"{log}.truth.npz")[key]
        track = observe_recording(read_recording(SHARED / "arm" / log, Settings()), Settings()).tracks[name]
        found = np.isfinite(track.values[:, 0])
        ratio = np.sqrt((track.std[found] ** 2).mean() / ((track.values - truth)[found] ** 2).mean())
        assert 0.7 < ratio < 1.3


def test_yellow_disc_is_tracked_in_every_real_image() -> None:
    from bodylog.recording.recording import read_recording

    path = SHARED / "gagalo123__mcap-explorer" / "examples" / "demo.mcap"
    if not path.exists():
        pytest.skip(f"{path} is not here")
    settings = Settings(colours=ColourSettings(effector="yellow"))
    health = observe_recording(read_recording(path, settings), settings).health["effector"]
    assert health.used == health.seen == 30


def test_further_cameras_look_for_what_is_on_the_arm_and_name_it_by_camera() -> None:
    head = scenes.frames(T[:10], _film([[Disc(u, v, 6.0)] for u, v in PATH[:10]], 0))
    pictures = _film([[Disc(v, u, 6.0), Disc(30.0, 30.0, 7.0, scenes.YELLOW)] for u, v in PATH[:10]], 1, 240, 320)
    side = scenes.frames(T[:10] + 0.01, pictures)
    settings = Settings(colours=ColourSettings(markers={"elbow": "yellow"}))
    alone = observe_recording(scenes.recording(head), settings)
    both = observe_recording(change_recording(scenes.recording(head), views={"side": side}), settings)
    assert list(both.tracks) == ["effector", "elbow", "side/effector", "side/elbow"]
    assert np.array_equal(both.tracks["effector"].values, alone.tracks["effector"].values)
    seen = both.tracks["side/effector"]
    assert np.allclose(seen.t, T[:10] + 0.01) and np.allclose(seen.values, PATH[:10, ::-1], atol=0.5)
    assert both.health["side/elbow"].used == 10
    blind = observe_recording(change_recording(scenes.recording(head), views={"side": lambda: iter(())}), settings)
    assert blind.tracks["side/effector"].values.shape == (0, 2)


def test_observe_names_a_colour_that_a_further_camera_never_saw_and_the_setting_to_type() -> None:
    pictures = scenes.frames(T[:5], _film([[Disc(100.0, 100.0, 15.0, scenes.YELLOW)]] * 5, 0))
    _, _, (finding,) = track_colours(pictures, {"side/effector": "green"})
    assert finding.text.startswith("side/effector: 'green' was never found in 5 pictures")
    assert finding.text.endswith('type: [colours] effector = "yellow"')
