"""Whether an explanation of a log is trusted: by how far its joints turn, and by what it leaves unexplained."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.factors.columns import EncoderShift, Path, Play
from bodylog.estimation.measurements.records import Encoders
from bodylog.estimation.methods import filtering, trust
from bodylog.settings import EstimationSettings
from bodylog.types import Array
from tests.estimation.conftest import draw
from tests.estimation.mechanisms import errors_and_nees
from tests.validation import logs, outliers


@dataclass
class Flat:
    """A track whose image is where it is expected, beside its error of variance 1 px²."""

    outputs: tuple[str, ...] = ("u", "v")


def sighting(values: Array) -> SimpleNamespace:
    """Images (F,2) px that are expected at 0."""
    t = np.arange(len(values)) / 20
    return SimpleNamespace(
        name="tip",
        t=t,
        values=values,
        var=np.ones(values.shape),
        cov=None,
        model=Flat(),
        displaced=None,
        source_ns=(t * 1e9).astype(np.int64),
    )


def misfit(values: Array) -> float:
    """The misfit of images (F,2) px."""
    none = np.zeros(values.shape)
    place = none, np.zeros((*values.shape, 2)), none
    problem = SimpleNamespace(evidence=SimpleNamespace(sightings=[sighting(values)]))
    found = SimpleNamespace(senses=("tip",), noise=SimpleNamespace(scales=(1.0,)))
    ((name, size),) = trust._measure_misfits(problem, found, SimpleNamespace(places={"tip": place}))
    assert name == "tip"
    return size


def correlated(rho: float, std: float = 1.0, count: int = 4000) -> Array:
    """First-order autoregressive errors (F,2) of this correlation from one to the next."""
    fresh = np.random.default_rng(3).normal(0.0, std, (count, 2))
    for k in range(1, count):
        fresh[k] = rho * fresh[k - 1] + np.sqrt(1.0 - rho**2) * fresh[k]
    return fresh


def test_misfit_is_the_variance_of_a_mean_over_the_stated_one():
    assert misfit(correlated(0.0)) == pytest.approx(1.0, rel=0.1)
    assert misfit(correlated(0.5)) == pytest.approx(3.0, rel=0.15)
    assert misfit(correlated(0.0, std=0.5)) == pytest.approx(0.25, rel=0.1)


def test_few_images_of_something_else_make_no_misfit():
    values = correlated(0.0)
    values[::100] = 300.0
    assert misfit(values) < 1.3


@pytest.mark.parametrize(
    ("turn", "setting", "reason"),
    [
        (0.3, {}, None),
        (0.01, {}, "lift turns by 0.009 rad"),
        (3e-3, {}, None),  # it rests
        (0.3, {"bias": "on"}, "set to on"),
        (0.3, {"motion": "white-jerk"}, None),
        (0.3, {"motion": "singer"}, "motion is set to singer"),
        (0.3, {"sigma_vision": 1.0}, "variances are set"),
        (0.3, {"hardware_errors": "widen"}, 'type hardware_errors = "explain"'),
    ],
)
def test_errors_are_looked_for_where_every_joint_turns_far_beyond_them(turn, setting, reason):
    angles = np.column_stack([np.linspace(0.0, 1.0, 101), np.linspace(0.0, turn, 101)])
    problem = SimpleNamespace(
        stepwise=False,
        evidence=SimpleNamespace(encoders=SimpleNamespace(values=angles), joints=("pan", "lift")),
        precision=SimpleNamespace(encoder=np.full(2, 1e-6)),
    )
    found = trust.find_reason_to_widen(problem, 2e-3, EstimationSettings(**setting))
    assert found is None if reason is None else reason in found


def test_no_joint_of_an_arm_at_rest_is_singled_out():
    angles = 1e-3 * np.random.default_rng(0).standard_normal((101, 2))
    problem = SimpleNamespace(
        stepwise=False,
        evidence=SimpleNamespace(encoders=SimpleNamespace(values=angles), joints=("pan", "lift")),
        precision=SimpleNamespace(encoder=np.full(2, 1e-6)),
    )
    found = trust.find_reason_to_widen(problem, 2e-3, EstimationSettings())
    assert found is not None and found.startswith("pan turns by")
    assert not trust.find_resting_joints(problem).any()


@pytest.mark.parametrize("seed", range(40, 43))
def test_readings_of_smooth_joints_have_no_colour_for_a_smoother_either(seed):
    """Its process is several times smaller than a filter's, whose innovations are judged."""
    world = draw(seed)
    alone = replace(world.features, tracks={})
    found = estimate_from_features(alone, world.body, EstimationSettings(method="smoother"))
    assert not [one.text for one in found.findings if "stick" in one.text]
    errors, nees = errors_and_nees(found, world.truth)
    assert 0.4 < nees < 2.0 and np.sqrt(np.mean(errors**2)) < 6e-3


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.soak
def test_false_first_readings_that_a_filter_believes_are_no_joints_that_stick(seed):
    """The filter loses the joint for half a second, and hindsight removes the readings."""
    spoil = outliers.KINDS["one encoder off by 0.5 rad in its first three"]
    log = spoil(logs.drawn("reach", seed, outliers.LENGTH, cameras=2), np.random.default_rng(seed))
    body = logs.learned(seed + 1, cameras=2)
    found = estimate_from_features(log.features, body, EstimationSettings(method="smoother"))
    assert not [one.text for one in found.findings if "stick" in one.text]
    errors, nees = errors_and_nees(found, log.truth)
    assert 0.3 < nees < 2.0 and np.sqrt(np.mean(errors**2)) < 1.2e-3


def test_readings_of_links_hold_the_play_and_not_what_is_left_of_a_step():
    """Two engines that blame play on images or on encoders differ by more than their error bars."""
    t = np.arange(0.0, 8.0, 0.01)
    motors = np.stack([0.4 * np.sin(t), 0.3 * np.cos(0.7 * t)], axis=1)
    encoders = Encoders(t, motors + [0.0, 2e-3] * (t >= 4.0)[:, None], (1e9 * t).astype(np.int64))
    columns = (Play("play", 1e-2, joint=0), EncoderShift("repaired step", 1e-2, joint=1, since=4.0))
    rest = np.zeros(motors.shape)
    learned = SimpleNamespace(sizes=np.array([2e-3, 2e-3]), path=Path(t, motors, rest, motors, rest))
    problem = replace(
        filtering.build_filter_problem((world := draw(1)).features, world.body, EstimationSettings())
    )
    evidence = replace(problem.evidence, encoders=encoders, joints=("a", "b"))
    problem = replace(problem, evidence=evidence, start=motors[0])
    moved = trust._move_readings_to_links(problem, SimpleNamespace(columns=columns, learned=learned))
    links = moved.evidence.encoders.values
    np.testing.assert_allclose(links[:, 1], motors[:, 1], atol=1e-12)
    far = links[:, 0] - motors[:, 0]
    turning = np.abs(np.cos(t)) > 0.5
    np.testing.assert_allclose(far[turning & (t > 1.0)], -2e-3 * np.sign(np.cos(t))[turning & (t > 1.0)], atol=5e-4)
