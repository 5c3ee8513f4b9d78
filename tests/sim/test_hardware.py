"""Errors of real joints and encoders: what is typed, and what a recording then holds."""

import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.kinematics import urdf
from bodylog.kinematics.weights import collect_weights
from bodylog.sim.arms import ARMS
from bodylog.sim.hardware import (
    Hardware,
    add_play,
    add_stick,
    encoder_noise,
    parse_hardware,
    rounded_to_counts,
)
from bodylog.sim.joint_motion import move_joints
from bodylog.sim.motion import wander_through_points

from . import reading

T = np.arange(0.0, 20.0, 0.01)
SWING = np.sin(T)[:, None] * np.array([0.3, 0.2])
DEGREE = np.deg2rad(1.0)
PIXEL = "/truth/effector_pixel"


def path(arm="ur5"):
    home = np.array(ARMS[arm].home)
    return wander_through_points(home + 0.3 * np.random.default_rng(3).standard_normal((22, len(home))), 1.0)


def test_every_error_is_typed_in_the_unit_that_help_names():
    typed = "play=0.25,sag=0.3,payload=1,stick=0.1,correlated=0.002@2s,counts=4096,tails=4,outliers=0.01,jitter=1e-3"
    expected = Hardware(
        play=0.25 * DEGREE, sag=0.3 * DEGREE, payload=DEGREE, stick=0.1 * DEGREE, correlated=0.002, correlation_s=2.0,
        counts=4096.0, tails=4.0, outliers=0.01, jitter=1e-3, rolling=0.015,
    )  # fmt: skip
    found = parse_hardware(f"{typed},rolling=0.015")
    assert vars(found) == pytest.approx(vars(expected))
    assert parse_hardware("") == Hardware()
    assert parse_hardware("correlated=0.002@0.2") == Hardware(correlated=0.002, correlation_s=0.2)
    assert parse_hardware("payload=1@8s") == Hardware(payload=DEGREE, payload_s=8.0)


@pytest.mark.parametrize(
    ("text", "field", "possible"),
    [
        ("paly=1", "'paly'", "nearest: play"),
        ("play", "play has no size", "0 to 20"),
        ("play=-1", "play is '-1'", "0 to 20"),
        ("play=nan", "play is 'nan'", "0 to 20"),
        ("play=21", "play is '21'", "0 to 20"),
        ("tails=1", "tails is '1'", "0, or 2.1 to 100"),
        ("correlated=0.002", "correlated is '0.002'", "rad, @, and a time constant"),
        ("correlated=0.002@0s", "correlated is '0.002@0s'", "above 0"),
        ("payload=1@x", "payload is '1@x'", "carried, above 0"),
        ("correlated=x@2s", "correlated is 'x'", "0 to 1"),
        ("play=1,play=2", "play is given twice", "play=2"),
        ("play=1,", "''", "play"),
    ],
)
def test_a_wrong_error_gets_one_line_with_what_is_possible(text, field, possible):
    with pytest.raises(UsageError) as caught:
        parse_hardware(text)
    line = str(caught.value)
    assert field in line and possible in line and "type: --hardware" in line and "\n" not in line


def test_the_command_ends_with_2_and_writes_nothing(run_cli, tmp_path):
    out = tmp_path / "log.mcap"
    assert run_cli("record", "babble", "-o", out, "--duration", 1, "--hardware", "play=x") == 2
    assert list(tmp_path.iterdir()) == []


def test_play_trails_the_motor_by_half_its_width_and_holds_while_it_turns_round():
    behind = add_play(SWING, 0.02) - SWING
    steps = np.diff(add_play(SWING, 0.02), axis=0)
    assert np.abs(behind).max() <= 0.01 + 1e-12
    assert np.allclose(behind[1:][steps > 0.0], -0.01) and np.allclose(behind[1:][steps < 0.0], 0.01)
    # of every turn of the sine, the part in which the motor crosses the play: 2 arccos(1 − play / amplitude) of 2π
    crossing = np.arccos(1.0 - 0.02 / np.array([0.3, 0.2])) / np.pi
    assert (steps[400:] == 0.0).mean(axis=0) == pytest.approx(crossing, abs=0.03)


def test_a_joint_that_sticks_holds_still_until_it_is_driven_far_enough():
    turned = add_stick(SWING, 0.05)
    jumps = np.diff(turned, axis=0)
    assert np.abs(turned - SWING).max() <= 0.05 + 1e-12
    assert np.abs(jumps[jumps != 0.0]).min() > 0.05 and (jumps == 0.0).mean() > 0.8


@pytest.mark.parametrize("seconds", [0.2, 2.0])
def test_correlated_errors_have_the_size_and_time_constant_typed(seconds):
    hardware = Hardware(correlated=2e-3, correlation_s=seconds)
    errors = encoder_noise(hardware, 0.0, (200_000, 3), 100.0, np.random.default_rng(5))
    lag = round(100 * seconds)
    fallen = (errors[lag:] * errors[:-lag]).mean() / (errors**2).mean()
    assert errors.std() == pytest.approx(2e-3, rel=0.05)
    assert fallen == pytest.approx(np.exp(-1.0), abs=0.05)


def test_tails_keep_the_variance_and_counts_are_steps():
    errors = encoder_noise(Hardware(tails=5.0), 1e-3, (100_000, 2), 100.0, np.random.default_rng(6))
    assert errors.std() == pytest.approx(1e-3, rel=0.03)
    assert (np.abs(errors) > 5e-3).mean() > 1e-4  # 6e-7 of normal errors
    counts = rounded_to_counts(Hardware(counts=4096), SWING) / (2 * np.pi / 4096)
    assert np.allclose(counts, np.round(counts)) and np.abs(counts - SWING / (2 * np.pi / 4096)).max() <= 0.5


def test_a_payload_is_carried_from_when_it_is_picked_up():
    t = np.linspace(0.0, 19.0, 200)
    always, later = (
        move_joints(path(), Hardware(payload=DEGREE, payload_s=since), ARMS["ur5"], 20.0) for since in (0.0, 8.0)
    )
    bent = [one.truth.position(t) - one.motors.position(t) for one in (always, later)]
    assert np.array_equal(always.motors.position(t), later.motors.position(t))
    assert not bent[1][t < 8.0].any()
    np.testing.assert_allclose(bent[1][t > 8.2], bent[0][t > 8.2], atol=1e-12)


@pytest.mark.parametrize("arm", ["ur5", "seven"])
def test_sag_moves_links_and_payload_the_truth_as_well(arm):
    hardware = Hardware(sag=0.3 * DEGREE, payload=0.5 * DEGREE)
    commanded = path(arm)
    moved = move_joints(commanded, hardware, ARMS[arm], 20.0)
    t = np.linspace(0.0, 19.0, 200)
    assert np.array_equal(moved.motors.position(t), commanded.position(t))
    payload = (moved.truth.position(t) - moved.motors.position(t)) / hardware.payload
    sag = (moved.links.position(t) - moved.truth.position(t)) / hardware.sag
    for share in (payload, sag):
        assert 0.3 < np.abs(share).max() <= 1.0
        # a joint with an upright axis carries nothing
        assert np.abs(share[:, 0]).max() < 1e-9
    # one compliance: torques are those of the links' masses, of every joint in the same proportion
    torques = collect_weights(urdf.load_urdf(ARMS[arm].urdf), ARMS[arm].joints, {}).torques(moved.motors.position(t))
    np.testing.assert_allclose(sag * np.abs(torques).max(), torques * np.abs(sag).max(), atol=1e-6)


def test_without_errors_the_path_is_the_commanded_one():
    commanded = path()
    moved = move_joints(commanded, Hardware(correlated=1e-3), ARMS["ur5"], 20.0)
    assert moved.motors is commanded and moved.links is commanded and moved.truth is commanded


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Read a recording with these errors and quiet encoders."""
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    from bodylog.sim import record_scenario

    folder = tmp_path_factory.mktemp("hardware")

    def read(hardware, duration=2.0):
        log = folder / f"{abs(hash((hardware, duration)))}.mcap"
        record_scenario("babble", log, seed=3, duration=duration, size=(64, 48), noise=1e-6, hardware=hardware)
        return reading.read(log)

    return read


def positions(topics, topic):
    t, values, names = reading.positions(topics, topic)
    return t, values[:, [names.index(name) for name in ARMS["ur5"].joints]]


def test_encoders_read_motors_and_truth_and_picture_are_of_the_links(recorded):
    plain, loose = recorded(""), recorded("play=2")
    _, read = positions(loose, "/joint_states")
    _, truth = positions(loose, "/truth/joint_states")
    _, commanded = positions(plain, "/truth/joint_states")
    assert np.abs(read - commanded).max() < 1e-5
    assert np.abs(truth - read).max() == pytest.approx(DEGREE, abs=1e-5)
    late = [topics[PIXEL][-1].message.point.x for topics in (plain, loose)]
    assert abs(late[0] - late[1]) > 0.1  # px, of a picture 64 px wide


def test_a_rolling_shutter_shows_a_later_arm_under_the_same_stamps(recorded):
    plain, rolling = recorded(""), recorded("rolling=0.1")
    for topic in ("/truth/effector_pose", "/truth/joint_states", "/joint_states"):
        assert all(
            one.t == other.t and str(one.message) == str(other.message)
            for one, other in zip(plain[topic], rolling[topic], strict=True)
        )
    before, shown = (np.array(list(reading.pixels(one, PIXEL).values())) for one in (plain, rolling))
    t = np.array(list(reading.pixels(plain, PIXEL)))
    later = np.interp(t + 0.1 * shown[:, 1] / 47, t, before[:, 0])
    inside = slice(2, -4)
    assert np.abs(shown[:, 0] - later)[inside].max() < 0.1 < np.abs(shown - before)[inside, 0].max()


def test_rows_of_a_bare_arm_are_exposed_at_their_own_instants(tmp_path):
    """Of 48 rows that take 0.1 s, the middle ones show what the next image of 20 Hz shows there."""
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    from bodylog.sim import record_scenario

    films = []
    for hardware in ("", "rolling=0.1"):
        log = tmp_path / f"film{hardware[:4]}.mcap"
        options = {"scene": "bare", "image": "raw", "size": (64, 48), "hardware": hardware}
        record_scenario("babble", log, seed=3, duration=2.0, **options)
        images = [row.message.data for row in reading.read(log)["/camera/image"]]
        films.append(np.array([np.frombuffer(bytes(one), np.uint8).reshape(48, 64, 3) for one in images], float))
    plain, rolling = films
    rows = slice(16, 32)
    later = np.abs(rolling[:-1, rows] - plain[1:, rows]).mean()
    moved = np.abs(plain[1:, rows] - plain[:-1, rows]).mean()
    noise = np.abs(plain[1:, :4] - plain[:-1, :4]).mean()
    assert later == pytest.approx(noise, rel=0.03) and moved > 1.2 * noise


def test_jittered_stamps_are_off_by_what_was_typed(recorded):
    topics = recorded("jitter=0.002")
    stamps = np.array([row.t for row in topics["/joint_states"]])
    off = stamps - np.array([row.t for row in topics["/truth/joint_states"]])
    assert off.std() == pytest.approx(0.002, rel=0.2) and (np.diff(stamps) >= 0.0).all()


def test_the_log_says_what_it_was_recorded_with_and_repeats_its_bytes(tmp_path):
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    from mcap.reader import make_reader

    from bodylog.sim import record_scenario

    logs = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for log in logs:
        record_scenario("reach", log, seed=3, duration=1.0, size=(64, 48), hardware="correlated=0.002@2s,jitter=0.001,stick=1")
    assert logs[0].read_bytes() == logs[1].read_bytes()
    with logs[0].open("rb") as stream:
        (metadata,) = (one.metadata for one in make_reader(stream).iter_metadata())
    assert metadata["hardware"] == "correlated=0.002@2s,jitter=0.001,stick=1"
