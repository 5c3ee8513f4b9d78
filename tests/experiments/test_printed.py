"""The paper's model in any reading: it is `estimation`'s where both can be run, and its parts are what they say."""

import numpy as np
import pytest

from bodylog.body.gp.fit import build, samples
from bodylog.body.paper_preset import paper
from bodylog.body_model import TouchConstants
from bodylog.estimation.methods import predictive_coding as algorithm
from bodylog.estimation.methods.grid import Plan, Sense
from bodylog.estimation.methods.paper_touch import Literal
from bodylog.experiments.cases import Explored, case, placed
from bodylog.experiments.printed import DT, Case, Map, Signals, Touching, _State, believed
from bodylog.experiments.static import kalman

WIDTH = 320.0
STEPS = 80


def _places(x):
    return np.column_stack([160 + 90 * np.sin(x[:, 0]) + 20 * x[:, 2], 120 + 80 * np.sin(x[:, 1] + 0.3 * x[:, 2])])


@pytest.fixture(scope="module")
def known():
    draw = np.random.default_rng(3)
    x = draw.uniform(-0.4, 0.4, (46, 3))
    return Explored(x, _places(x), {})


@pytest.fixture(scope="module")
def signals():
    draw, t = np.random.default_rng(4), DT * np.arange(STEPS)
    true = 0.3 * np.sin(t[:, None] * [0.7, 0.5, 0.9])
    encoders, place = true + 0.02 * draw.standard_normal(true.shape), _places(true)
    encoders[10:20, 1], place[30:40] = np.nan, np.nan
    return Signals(t, encoders, place, np.full((STEPS, 2), np.nan), np.full(STEPS, np.nan), true)


@pytest.mark.parametrize("integration", ["printed", "implicit"])
def test_printed_model_equals_estimation(known, signals, integration):
    """In the reading of the preset `paper`: noise of exp(0.02) px, σ_v in squared widths."""
    found = samples(known.x, known.y)
    gp = build(found, paper(found), ("u", "v"), "px")
    start = np.array([0.1, -0.1, 0.05])
    senses = (Sense("encoders", signals.encoders, None, np.ones((STEPS, 3)), printed=True),
              Sense("effector", signals.place / WIDTH, gp, np.full((STEPS, 2), 5.0), WIDTH, True))  # fmt: skip
    plan = Plan(senses, None, signals.t, DT, np.ones(3), start, np.zeros(3), start[None])
    theirs = {"printed": algorithm.explicitly, "implicit": algorithm.implicitly}[integration](plan)[0]
    model = Map(gp.centres, gp.scales[0], gp.amplitude[0] * gp.weights.T, gp.mean, known.scatter)
    mine = believed(signals, [Case(model, (True,) * 3, True, WIDTH, integration, start, start)]).x[0]
    assert np.allclose(mine, theirs, atol=1e-9) and np.abs(np.diff(mine, axis=0)).max() > 1e-3


def test_noise_reading_equals_the_preset(known):
    found = samples(known.x, known.y)
    gp = build(found, paper(found), ("u", "v"), "px")
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
    state = _State(felt, [one])
    g, slope = state.places()
    steps = 1e-6 * np.eye(3)
    assert np.allclose(slope[0], (one.model.at(x + steps) - one.model.at(x - steps)).T / 2e-6, atol=1e-3)
    off, pull, _ = state._touch(0, g, slope)
    weight = np.exp(-40.0 * 0.05**2)
    other = Literal(
        _Known(one.model, slope), TouchConstants(0.9, 0.004), np.array([True]), hand[None], np.array([weight])
    )
    assert np.allclose(other.pull(0, x[0])[0], off[0]) and np.allclose(other.pull(0, x[0])[1], pull[0])


class _Known:
    """A map with its slope, as `estimation` asks for it."""

    def __init__(self, model, slope):
        self.predict = lambda x: (model.at(x), slope, np.zeros((1, 2)))


def test_many_at_once_are_each_alone_and_what_diverges_is_not_a_number(known, signals):
    given = [{}, {"sigma_v": "pixels"}, {"integration": "equilibrium"}, {"mu_x": "zero", "integration": "implicit"}]
    cases = [case(known, reading, "p1+p3+v", np.array([0.1, 0.1, 0.1])) for reading in given]
    together = believed(signals, cases).x
    for k, one in enumerate(cases):
        assert np.array_equal(together[k], believed(signals, [one]).x[0], equal_nan=True)
    assert np.isfinite(together[0]).all() and not np.allclose(together[0], together[2], atol=1e-4)
    far = Case(cases[0].model, (True,) * 3, True, 1e-3, "printed", np.zeros(3), np.zeros(3))
    assert np.isnan(believed(signals, [far]).x[0, -1]).all()


def test_case_uses_only_the_requested_senses(known, signals):
    start = np.array([0.1, 0.1, 0.1])
    deaf = Signals(
        signals.t, signals.encoders * [1, np.nan, 1], signals.place, signals.hand, signals.delay, signals.true
    )
    one, other = (believed(s, [case(known, {}, "p1+p3+v", start)]).x for s in (signals, deaf))
    assert np.array_equal(one, other)


def test_units_are_those_of_the_reading(known):
    start = np.zeros(3)
    units = {
        v: case(known, {"sigma_v": v}, "v", start).unit
        for v in ("standardised", "pixels", "half-widths", "widths", "17")
    }
    assert units == {"standardised": known.scatter, "pixels": 1.0, "half-widths": 160.0, "widths": 320.0, "17": 17.0}
    touch = case(known, {"b_1": "pixels", "a_2": "1", "sigma_t": "1", "b_2": "0.06"}, "p+t", start).touch
    assert (touch.b1, touch.a, touch.sigma) == (1.0, 0.001, 1.0) and np.exp(-touch.b2 * 0.06**2) == pytest.approx(0.5)
    assert case(known, {"sigma_t": "100"}, "p+t", start).touch.sigma == pytest.approx(100.0)
    assert np.array_equal(case(known, {"mu_x": "home"}, "p", start).prior, known.home)


def test_placed_moves_the_hand_to_the_effector(signals):
    by, hand = np.array([3.0, -30.0]), np.ones((STEPS, 2))
    seen = Signals(signals.t, signals.encoders, signals.place, hand, signals.delay, signals.true)
    assert np.array_equal(placed(seen, {}, by).hand, hand - by) and placed(seen, {"o_v": "hand"}, by) is seen


def test_kalman_settles_at_its_static_gain():
    """Of Q = 0.001 and R = 1: the steady gain k solves k² / (1 − k) = Q/R."""
    t = np.zeros(400)
    gaps = [np.full((400, n), np.nan) for n in (2, 2)]
    log = Signals(t, np.r_[np.zeros((399, 1)), [[1.0]]], gaps[0], gaps[1], t, np.zeros((400, 1)))
    k = kalman(log, np.zeros(1))[-1, 0]
    assert k**2 / (1 - k) == pytest.approx(0.001, rel=0.01)
