"""Errors of encoders that last: found without truth, and error bars that are wider for them."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.methods import results
from bodylog.estimation.methods.filtering import build_filter_problem
from bodylog.fault_kinds import Fault as FoundFault
from bodylog.findings import verdict
from bodylog.settings import EstimationSettings
from bodylog.types import HARDWARE_ERRORS, LASTING_ERROR, FaultKind
from tests.estimation import mechanisms
from tests.estimation.conftest import JOINTS
from tests.estimation.mechanisms import LASTING, LOOSE, Fault, errors_and_nees, true_angles
from tests.estimation.spoilt_logs import muted
from tests.seeds import first_of
from tests.validation import logs, outliers

METHODS = ("filter", "smoother")
SOUND = ("sound", "quantised", "quiet")


def without_widening(monkeypatch):
    from bodylog.estimation.methods import explained, results

    monkeypatch.setattr(results, "find_lasting_error", lambda *_: None)
    monkeypatch.setattr(explained, "measure_rough_motion", lambda *_: None)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("mechanism", "std"), [(LASTING, 2e-3), (LOOSE, 4e-3)], ids=["correlated", "play"]
)
def test_error_bars_hold_an_error_that_lasts_and_a_warning_tells_its_size(
    method, mechanism, std, monkeypatch
):
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features, true = mechanisms.replayed(4, mechanism, Fault()), true_angles(4, mechanism)
    settings = EstimationSettings(method=method, hardware_errors="widen")
    found = estimate_from_features(features, body, settings, "off")
    own = found.settings[LASTING_ERROR]
    assert own["std"] == pytest.approx(std, rel=0.5) and own["nats"] > 12.0
    assert 0.3 < errors_and_nees(found, true)[1] < 2.0
    (warning,) = (one for one in found.findings if "errors last about" in one.text)
    assert warning.severity == "warning" and "mrad" in warning.text
    assert any("errors last about" in line for line in verdict.verdict_of_estimate(found, ()))
    without_widening(monkeypatch)
    narrow = estimate_from_features(features, body, settings, "off")
    assert errors_and_nees(narrow, true)[1] > 5.0
    assert np.array_equal(narrow.joints.values, found.joints.values)
    assert np.allclose(found.cov - narrow.cov, own["std"] ** 2 * np.eye(3))


@pytest.mark.parametrize(
    "mechanism", [mechanisms.SOUND, mechanisms.QUANTISED, mechanisms.QUIET], ids=SOUND
)
def test_a_sound_log_gets_no_warning_and_keeps_its_error_bars(mechanism):
    body = mechanisms.learned(1000, mechanism)
    for seed in range(3):
        found = estimate_from_features(
            mechanisms.replayed(seed, mechanism, Fault(), reaches=seed % 2 == 1),
            body,
            EstimationSettings(),
        )
        assert not {LASTING_ERROR, HARDWARE_ERRORS} & set(found.settings)


@pytest.mark.parametrize("seed", first_of(1, [0, 3]))
def test_images_of_something_else_are_no_error_of_the_encoders(seed):
    sound = logs.drawn("reach", seed, outliers.LENGTH, cameras=2)
    wrong = outliers.images(0.05, 15.0, run=6)(sound, np.random.default_rng(seed))
    body = logs.learned(seed + 1, cameras=2)
    found = estimate_from_features(wrong.features, body, EstimationSettings())
    assert LASTING_ERROR not in found.settings


@pytest.mark.parametrize("seed", [0, 3])
def test_a_silence_that_images_leave_open_shows_no_error_of_the_encoders(world, seed):
    """Beliefs of two silent joints are off by 0.1 rad for seconds."""
    drawn = world(seed, duration=20.0)
    silent = muted(drawn.features, 6.0, 16.0, ("pan", "lift"))
    found = estimate_from_features(silent, drawn.body, EstimationSettings())
    assert LASTING_ERROR not in found.settings


def test_an_error_that_lasts_is_found_beside_a_silence():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features = mechanisms.replayed(4, LASTING, Fault())
    begin = float(features.joints.t[0]) + 6.0
    silent = muted(features, begin, begin + 5.0, ("pan", "lift"))
    found = estimate_from_features(silent, body, EstimationSettings())
    own = found.settings[LASTING_ERROR]
    assert own["std"] == pytest.approx(2e-3, rel=0.5) and own["nats"] > 12.0


def test_noise_that_is_set_is_left_as_it_is():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features = mechanisms.replayed(4, LASTING, Fault())
    given, typed = (
        estimate_from_features(features, body, EstimationSettings(**setting)).settings
        for setting in ({"precision": "model"}, {"sigma_encoders": 1e-6})
    )
    assert LASTING_ERROR not in given
    assert not any(HARDWARE_ERRORS in one for one in (given, typed))


def test_a_log_with_a_single_reading_has_no_lasting_error():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features = mechanisms.replayed(0, mechanisms.SOUND, Fault())
    joints = features.joints
    single = replace(
        joints, t=joints.t[:1], values=joints.values[:1], source_ns=joints.source_ns[:1]
    )
    found = estimate_from_features(replace(features, joints=single), body, EstimationSettings())
    assert LASTING_ERROR not in found.settings
    assert np.isfinite(found.joints.values).all()


def test_offsets_that_are_no_faults_hide_no_error_that_lasts(monkeypatch):
    """Walks of all encoders follow what lasts; only an encoder whose offset is named tells nothing."""
    features = mechanisms.replayed(4, LASTING, Fault())
    settings = EstimationSettings()
    problem = build_filter_problem(features, mechanisms.learned(1000, mechanisms.SOUND), settings)
    true = true_angles(4, LASTING)
    t = problem.timeline.t
    angles = np.column_stack([np.interp(t, true.t, column) for column in true.values.T])
    rates = np.gradient(angles, t, axis=0)
    beliefs = np.hstack([angles, rates, np.full(angles.shape, 1e-3)])
    monkeypatch.setattr(results, "estimate_white_nees", lambda found, more: 10.0)
    found = results.find_evident_error(None, problem, beliefs, settings, ())
    assert found.std == pytest.approx(2e-3, rel=0.5)
    named = [FoundFault("encoders", name, FaultKind.DRIFTING, 0.0, 0.1, "rad", 1e-3) for name in JOINTS]
    assert results.find_evident_error(None, problem, beliefs, settings, named) is None
