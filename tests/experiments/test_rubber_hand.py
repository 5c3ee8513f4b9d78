"""The rubber hand as an instrument: what is shifted, and on one small robot what the documented setting gives."""

import numpy as np
import pytest

from bodylog.experiments import Setting, rubber_hand
from bodylog.experiments.claims import OWN_HOLDS
from bodylog.experiments.lab import Lab, ObservedLog
from bodylog.experiments.records import ExperimentReadings
from bodylog.types import Features, Series, Stroke, Touch


def test_displaced_delays_and_shifts_the_hand_and_recomputes_synchrony():
    t = np.arange(0.0, 10.0, 0.1)
    hand = Series(t, np.ones((len(t), 2)), ("u", "v"), "px", t)
    touches = tuple(Touch(s, s + 0.8, (3,), 0.9, 3, 0) for s in (2.0, 6.0))
    strokes = tuple(Stroke(s, s + 0.8, (0.0, 0.0), (1.0, 1.0)) for s in (2.0, 6.0))
    log = ObservedLog(Features(hand, {"hand": hand}, touches, strokes, (), {}), hand)
    found = rubber_hand.displace_hand(log, 0.12, 1.5, -1.0).features
    assert np.allclose(found.hand.t, t + 0.12) and np.allclose(
        found.hand.values[0], [1 - 0.5 * rubber_hand.DISPLACEMENT, 1]
    )
    assert [pair.delay for pair in found.synchrony] == pytest.approx([0.12, 0.12])
    assert [pair.weight for pair in found.synchrony] == pytest.approx([0.5, 0.5])
    assert rubber_hand.has_weighted_touch(found) and not rubber_hand.has_weighted_touch(
        rubber_hand.displace_hand(log, 1.0, 1.0, 1.0).features
    )


@pytest.mark.soak
def test_rubber_hand_drifts_with_synchronous_touch_only(tmp_path):
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    lab = Lab(tmp_path, (320, 240), 12.0)
    setting = Setting((0.0, 0.15, 0.6), (0.5, 2.0), (0.02, 0.3))
    trial = rubber_hand.run_rubber_hand_sweeps(lab, 0, ExperimentReadings(({},)), setting)
    figures = trial["figures"]
    assert figures["in time"] >= 0.15 and figures["late"] <= 0.02 and figures["rise"] < 0.0
    assert figures["noise 0.02 right"] < figures["asynchrony 0 right"] < figures["noise 0.3 right"]
    assert figures["displacement 0.5 right px"] == pytest.approx(
        0.5 * figures["asynchrony 0 right px"], rel=0.2
    )
    assert figures["asynchrony 0 right cm"] == pytest.approx(
        figures["asynchrony 0 right px"] / 2.4, rel=0.05
    )
    claims = rubber_hand.EXPERIMENT.claims([trial], ExperimentReadings(({},)))
    assert [claim.verdict for claim in claims] == [OWN_HOLDS] * 5
    assert len(rubber_hand.EXPERIMENT.tables([trial])) == 4
    assert figures["inferred displacement 0.5 right"] > 0.9 * figures["displacement 0.5 right"]
    assert abs(figures["inferred displacement 2 right"]) < 0.1 * figures["displacement 2 right"]
