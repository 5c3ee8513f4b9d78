"""The paper's model in any reading: Algorithm 1 written out, `estimation`'s where both can be run, and its parts."""

import numpy as np
import pytest

from bodylog.body.gp.fit import build_gp, samples_without_noise
from bodylog.body.paper_preset import paper_kernels
from bodylog.body_model import TouchConstants
from bodylog.estimation.methods import predictive_coding as algorithm
from bodylog.estimation.methods.algorithm1 import PaperTouch
from bodylog.estimation.methods.grid import GridProblem, GridSense
from bodylog.experiments.cases import HAND_STD_PX, ExplorationSamples, build_case, place_hand
from bodylog.experiments.drawn import place_in_image as true_place
from bodylog.experiments.printed import (
    DT,
    Case,
    CaseSenses,
    Map,
    Signals,
    Touching,
    filter_encoders,
    run_printed_model,
)

WIDTH = 320.0
STEPS = 80


def _places(x):
    return np.column_stack([160 + 90 * np.sin(x[:, 0]) + 20 * x[:, 2], 120 + 80 * np.sin(x[:, 1] + 0.3 * x[:, 2])])


@pytest.fixture(scope="module")
def known():
    draw = np.random.default_rng(3)
    x = draw.uniform(-0.4, 0.4, (46, 3))
    return ExplorationSamples(x, _places(x), {})


@pytest.fixture(scope="module")
def signals():
    draw, t = np.random.default_rng(4), DT * np.arange(STEPS)
    true = 0.3 * np.sin(t[:, None] * [0.7, 0.5, 0.9])
    encoders, place = true + 0.02 * draw.standard_normal(true.shape), _places(true)
    encoders[10:20, 1], place[30:40] = np.nan, np.nan
    return Signals(t, encoders, place, np.full((STEPS, 2), np.nan), np.full(STEPS, np.nan), true)


@pytest.mark.parametrize("integration", ["printed", "implicit"])
def test_printed_model_equals_estimation(known, signals, integration):
    """In the reading of the preset `paper_kernels`: noise of exp(0.02) px, σ_v in squared widths."""
    found = samples_without_noise(known.x, known.y)
    gp = build_gp(found, paper_kernels(found), ("u", "v"), "px")
    start = np.array([0.1, -0.1, 0.05])
    senses = (GridSense("encoders", signals.encoders, None, np.ones((STEPS, 3)), printed=True),
              GridSense("effector", signals.place / WIDTH, gp, np.full((STEPS, 2), 5.0), WIDTH, True))  # fmt: skip
    plan = GridProblem(senses, None, signals.t, DT, np.ones(3), start, np.zeros(3), start[None])
    theirs = algorithm.integrate_belief(plan, integration == "printed")[0]
    model = Map(gp.centres, gp.scales[0], gp.amplitude[0] * gp.weights.T, gp.mean, known.scatter)
    mine = run_printed_model(signals, [Case(model, (True,) * 3, True, WIDTH, integration, start, start)]).x[0]
    assert np.allclose(mine, theirs, atol=1e-9) and np.abs(np.diff(mine, axis=0)).max() > 1e-3


def test_noise_reading_equals_the_preset(known):
    found = samples_without_noise(known.x, known.y)
    gp = build_gp(found, paper_kernels(found), ("u", "v"), "px")
    x = np.random.default_rng(5).uniform(-0.4, 0.4, (20, 3))
    assert np.allclose(
        known.map({"sigma_n": f"{np.exp(0.02):.15g}"}).at(x), gp.predict(x)[0], atol=0.5
    )  # its mean is weighed
    assert np.abs(known.map({}).at(x) - _places(x)).max() < 2.0 < np.abs(gp.predict(x)[0] - _places(x)).max()
    assert np.abs(known.map({"sigma_n": "learned"}).at(x) - _places(x)).max() < 1.0


def test_slopes_are_differences_and_touch_pulls_as_printed(known, signals):
    x = np.array([[0.1, -0.2, 0.05]])
    touched = Touching(0.9, 0.004, 40.0, 1.0, "best")
    hand = np.array([200.0, 130.0])
    one = Case(known.map({}), (True,) * 3, True, 1.0, "printed", x[0], x[0], touched)
    felt = Signals(
        signals.t, signals.encoders, signals.place, np.tile(hand, (STEPS, 1)), np.full(STEPS, 0.05), signals.true
    )
    senses = CaseSenses(felt, [one])
    g, slope = senses.places(x)
    steps = 1e-6 * np.eye(3)
    assert np.allclose(slope[0], (one.model.at(x + steps) - one.model.at(x - steps)).T / 2e-6, atol=1e-3)
    off, pull = senses.touch(0, g, slope)
    weight = np.exp(-40.0 * 0.05**2)
    other = PaperTouch(
        _Known(one.model, slope), TouchConstants(0.9, 0.004), np.array([True]), hand[None], np.array([weight])
    )
    error, slope_here = other.measure_touch_error(0, x[0])
    assert np.allclose(error, off[0]) and np.allclose(slope_here, pull[0])


class _Known:
    """A map with its slope, as `estimation` asks for it."""

    def __init__(self, model, slope):
        self.predict = lambda x: (model.at(x), slope, np.zeros((1, 2)))


def test_many_at_once_are_each_alone_and_what_diverges_is_not_a_number(known, signals):
    given = [{}, {"sigma_v": "pixels"}, {"integration": "equilibrium"}, {"mu_x": "zero", "integration": "implicit"}]
    cases = [build_case(known, reading, "p1+p3+v", np.array([0.1, 0.1, 0.1])) for reading in given]
    together = run_printed_model(signals, cases).x
    for k, one in enumerate(cases):
        assert np.array_equal(together[k], run_printed_model(signals, [one]).x[0], equal_nan=True)
    assert np.isfinite(together[0]).all() and not np.allclose(together[0], together[2], atol=1e-4)
    far = Case(cases[0].model, (True,) * 3, True, 1e-3, "printed", np.zeros(3), np.zeros(3))
    assert np.isnan(run_printed_model(signals, [far]).x[0, -1]).all()


def test_case_uses_only_the_requested_senses(known, signals):
    start = np.array([0.1, 0.1, 0.1])
    deaf = Signals(
        signals.t, signals.encoders * [1, np.nan, 1], signals.place, signals.hand, signals.delay, signals.true
    )
    one, other = (run_printed_model(s, [build_case(known, {}, "p1+p3+v", start)]).x for s in (signals, deaf))
    assert np.array_equal(one, other)


def test_units_are_those_of_the_reading(known):
    start = np.zeros(3)
    units = {
        v: build_case(known, {"sigma_v": v}, "v", start).unit
        for v in ("standardised", "pixels", "half-widths", "widths", "17")
    }
    assert units == {"standardised": known.scatter, "pixels": 1.0, "half-widths": 160.0, "widths": 320.0, "17": 17.0}
    touch = build_case(known, {"b_1": "pixels", "a_2": "1", "sigma_t": "1", "b_2": "0.06"}, "p+t", start).touch
    assert (touch.b1, touch.a, touch.sigma) == (1.0, 0.001, 1.0) and np.exp(-touch.b2 * 0.06**2) == pytest.approx(0.5)
    assert build_case(known, {"sigma_t": "100"}, "p+t", start).touch.sigma == pytest.approx(100.0)
    assert np.array_equal(build_case(known, {"mu_x": "home"}, "p", start).prior, known.home)


def test_hand_is_placed_by_the_reading_of_where_it_is_seen(signals):
    by, hand = np.array([3.0, -30.0]), np.ones((STEPS, 2))
    hand[:20] = np.nan
    seen = Signals(signals.t, signals.encoders, signals.place, hand, signals.delay, signals.true)
    assert place_hand(seen, {"o_v": "hand"}, by, 0.0, 0) is seen
    stroke = place_hand(seen, {"o_v": "stroke"}, by, 0.0, 0).hand
    assert np.array_equal(stroke, hand - by, equal_nan=True)
    touched = place_hand(seen, {}, by, 38.0, 0).hand
    off = touched[20:] - true_place(signals.true[20:]) - [38.0, 0.0]
    assert np.isnan(touched[:20]).all() and np.abs(off.mean(axis=0)).max() < 0.15
    assert np.std(off) == pytest.approx(HAND_STD_PX, rel=0.3)


@pytest.mark.parametrize("reading", [{}, {"lambda": "step"}, {"integration": "equilibrium"}, {"mu_x": "zero"}])
def test_printed_model_is_algorithm_1_written_out(known, signals, reading):
    """Encoders, vision and touch, one instant after another, as Algorithm 1 has them with its errata corrected."""
    hand = np.where((np.arange(STEPS) % 3 > 0)[:, None], [200.0, 130.0], np.nan)
    felt = Signals(signals.t, signals.encoders, signals.place, hand, np.full(STEPS, 0.05), signals.true)
    one = build_case(known, reading, "p+v+t", np.array([0.1, -0.1, 0.05]))
    mine = run_printed_model(felt, [one]).x[0]
    assert np.allclose(mine, _written_out(felt, one), atol=1e-9) and np.abs(np.diff(mine, axis=0)).max() > 1e-3


def _written_out(signals, one):
    x, mu, e_x = one.start, one.prior, np.zeros(3)
    errors = {"p": np.zeros(3), "v": np.zeros(2), "t": np.zeros(1)}
    found = []
    for k in range(len(signals.t)):
        g = one.model.at(x[None])[0]
        steps = 1e-6 * np.eye(3)
        jac = (one.model.at(x + steps) - one.model.at(x - steps)).T / 2e-6
        best = one.touch.a * np.exp(-one.touch.b2 * signals.delay[k] ** 2)
        g_t = best * np.exp(-one.touch.b1 * np.sum((g - signals.hand[k]) ** 2))
        senses = {
            "p": (signals.encoders[k] - x, np.eye(3), 1.0),
            "v": ((signals.place[k] - g) / one.unit, jac / one.unit, 5.0),
            "t": (np.array([best - g_t]), -2 * one.touch.b1 * g_t * (g - signals.hand[k])[None] @ jac, one.touch.sigma),
        }
        prior_off = x - mu
        rest = one.integration == "equilibrium"
        e_now = prior_off if rest else e_x
        dx = -e_now
        for name, (off, slope, sigma) in senses.items():
            here = np.isfinite(off)
            errors[name] = np.where(here, errors[name], 0.0)
            off, slope = np.where(here, off, 0.0), np.where(here[:, None], slope, 0.0)
            dx = dx + slope.T @ (off / sigma if rest else errors[name])
            errors[name] = errors[name] + DT * np.where(here, off - sigma * errors[name], 0.0)
        e_x = e_x + DT * (prior_off - e_x)
        x, mu = x + DT * dx, mu + DT * one.rate * e_now
        found.append(x)
    return np.array(found)


def test_belief_beyond_the_widest_angle_has_diverged(known, signals):
    """In px² one Euler step is unstable; the belief stays finite, and is no belief."""
    found = run_printed_model(signals, [build_case(known, {"sigma_v": "pixels"}, "p+v", np.full(3, 0.1))]).x[0]
    first = int(np.flatnonzero(np.isnan(found[:, 0]))[0])
    assert np.isnan(found[first:]).all() and np.abs(found[:first]).max() <= np.pi


def test_kalman_settles_at_its_static_gain():
    """Of Q = 0.001 and R = 1: the steady gain k solves k² / (1 − k) = Q/R."""
    t = np.zeros(400)
    gaps = [np.full((400, n), np.nan) for n in (2, 2)]
    log = Signals(t, np.r_[np.zeros((399, 1)), [[1.0]]], gaps[0], gaps[1], t, np.zeros((400, 1)))
    k = filter_encoders(log, np.zeros(1))[-1, 0]
    assert k**2 / (1 - k) == pytest.approx(0.001, rel=0.01)
