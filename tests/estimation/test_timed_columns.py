"""When a load is carried: its moments, by the same Schur complement as columns that are there from the start."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.factors import hypotheses, timed_columns
from bodylog.estimation.factors.columns import EncoderShift, ImageShift, Path, Play
from bodylog.estimation.factors.elimination import eliminate_states
from bodylog.estimation.factors.factor_problem import build_system, linearise_problem
from bodylog.estimation.factors.gauss_newton import guess_path, solve_problem
from bodylog.estimation.factors.load import PostureLoad, describe_load
from bodylog.estimation.factors.timed_columns import (
    LinkShift,
    _change_between,
    _extend_schur,
    list_displaced_images,
    list_timed_loads,
    weigh_displacements,
)
from bodylog.estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS
from bodylog.settings import EstimationSettings
from bodylog.types import HARDWARE_ERRORS
from tests.estimation import factor_problems, mechanisms
from tests.estimation.mechanisms import REALISTIC, SOUND, Fault, errors_and_nees, links_of

SAG = 1.75e-2
"""rad: 1° of the lift's."""
ALWAYS = (-np.inf,)


def bent(joint, moments=ALWAYS):
    return PostureLoad("posture", 1.0, group=joint, joint=joint, moments=moments)


@pytest.mark.parametrize("seed", range(3))
def test_columns_added_later_have_the_schur_complement_of_columns_that_are_there(seed):
    rng = np.random.default_rng(seed)
    known = (EncoderShift("repaired step", 1e-3, mean=2e-3, joint=1, since=0.2),)
    problem = factor_problems.drawn(rng, known)
    more = (bent(0, (0.1, 0.25)), bent(1, (0.2,)), LinkShift("shift", 1.0, joint=0, since=0.15, until=0.45))
    noise = replace(factor_problems.noise(rng), groups=(1.0, 1.0))
    path = guess_path(problem)
    linear = linearise_problem(problem, path, noise)
    found = _extend_schur(linear, eliminate_states(build_system(linear)), more)
    whole = linearise_problem(replace(problem, columns=(*known, *more)), path, noise)
    np.testing.assert_allclose(found, eliminate_states(build_system(whole)).schur, rtol=1e-6, atol=1e-6 * found[0, 0])


def moved_images(problem, shifts, sizes):
    """The problem with images displaced by shifts of these sizes, px."""
    (sighting,), (images,) = problem.sightings, problem.images
    seen = guess_path(problem).at_images(images)
    rows = sum(size * one.displaces_images(images, seen) for one, size in zip(shifts, sizes, strict=True))
    return replace(problem, sightings=(replace(sighting, values=sighting.values + rows),))


@pytest.mark.parametrize("seed", range(3))
def test_images_that_are_displaced_for_a_while_are_found(seed):
    rng = np.random.default_rng(seed)
    problem = factor_problems.drawn(rng, images=64)
    shifts = tuple(ImageShift("displaced", 9.0, camera="camera", axis=axis, since=1.0, until=2.0) for axis in range(2))
    assumed = factor_problems.noise(rng, lasting=False)
    for sizes, moved in (((0.0, 0.0), False), ((5.0, -3.0), True)):
        spoilt = moved_images(problem, shifts, sizes)
        path = guess_path(spoilt)
        found = [
            (one, cost) for one, cost in list_displaced_images(spoilt, assumed, path)
            if weigh_displacements(spoilt, assumed, path, [one])[0] - cost > EVIDENCE_THRESHOLD_NATS
        ]
        assert len(found) == moved
        for own, _ in found:
            assert [one.axis for one in own] == [0, 1]
            np.testing.assert_allclose([own[0].since, own[0].until], [1.0, 2.0], atol=0.06)
            whole = replace(spoilt, columns=own)
            each = (eliminate_states(build_system(linearise_problem(one, path, assumed))).nats for one in (spoilt, whole))
            without, beside = each
            assert weigh_displacements(spoilt, assumed, path, [own])[0] == pytest.approx(without - beside, rel=1e-6)


@pytest.mark.parametrize("window", [(1.01, 1.02), (-1.0, 9.0)])
def test_a_window_holds_some_images_and_not_all(window, monkeypatch):
    rng = np.random.default_rng(0)
    problem = factor_problems.drawn(rng, images=64)
    assumed = factor_problems.noise(rng, lasting=False)
    path = guess_path(problem)
    monkeypatch.setattr(timed_columns, "_narrow_window", lambda *_: (-1e9, window))
    assert list(list_displaced_images(problem, assumed, path)) == []


def test_windows_that_are_narrowed_lie_apart_in_order_of_probability():
    windows = [(1.0, 2.0), (1.1, 2.0), (1.0, 4.0), (-np.inf, 2.0), (-np.inf, 2.1)]
    found = timed_columns._list_separate(windows, np.array([3.0, 2.0, 4.0, 1.0, 0.0]), 0.15)
    assert found == [(-np.inf, 2.1), (1.1, 2.0), (1.0, 4.0)]
    many = [(float(k), np.inf) for k in range(20)]
    assert timed_columns._list_separate(many, np.arange(20.0), 0.15) == many[: timed_columns.SEARCHED]


def test_a_shift_of_a_link_is_minus_that_of_its_encoder():
    t = np.linspace(0.0, 4.0, 9)
    path = Path(t, *[np.zeros((9, 2))] * 4)
    shown = LinkShift("shift", 1.0, joint=1, since=1.0, until=1.0).moves_links(path)
    read = EncoderShift("shift", 1.0, joint=1, since=1.0).changes_readings(t, path)
    np.testing.assert_allclose(shown, read)


def test_a_shift_of_a_link_that_grows_is_a_ramp():
    t = np.linspace(0.0, 4.0, 9)
    path = Path(t, *[np.zeros((9, 2))] * 4)
    shown = LinkShift("shift", 1.0, joint=1, since=1.0, until=4.0).moves_links(path)
    np.testing.assert_allclose(shown[:, 0], 0.0)
    np.testing.assert_allclose(shown[:, 1], np.maximum(t - 1.0, 0.0) / 3.0)


def test_a_change_takes_a_load_where_there_is_none_and_puts_it_down_where_there_is_one():
    assert _change_between((), (2.0, 4.0)) == (2.0, 4.0)
    assert _change_between((2.0, 8.0), (4.0, 6.0)) == (2.0, 4.0, 6.0, 8.0)
    assert _change_between((2.0, 4.0), (4.0, 6.0)) == (2.0, 6.0)
    assert _change_between((2.0, 4.0), (-np.inf, np.inf)) == (-np.inf, 2.0, 4.0)
    path = Path(np.arange(5.0) + 0.5, *[np.zeros((5, 1))] * 4)
    shares = {
        (1.0, 3.0): [0, 1, 1, 0, 0],
        ALWAYS: [1] * 5,
        (-np.inf, 2.0, 4.0): [1, 1, 0, 0, 1],
        (1.55, 3.0): [0, 0.25, 1, 0, 0],  # a hand takes it up within TAKEN_S
    }
    for moments, carried in shares.items():
        np.testing.assert_allclose(bent(0, moments).moves_links(path)[:, 0], carried, atol=1e-12)


@pytest.mark.parametrize("moments", [(1.0,), (1.5, 3.0), (-np.inf, 1.5), (0.8, 2.2, 3.6, 5.2)])
def test_moments_are_found_between_two_images(moments):
    rng = np.random.default_rng(4)
    problem = factor_problems.drawn(rng, images=128)
    path = guess_path(problem)
    loads = tuple(bent(j) for j in range(2))
    rows = 0.02 * sum(replace(one, moments=moments).moves_links(path.at_images(problem.images[0])) for one in loads)
    (sighting,) = problem.sightings
    seen = sighting.values + np.einsum("dm,fm->fd", sighting.model.a, rows)
    problem = replace(problem, sightings=(replace(sighting, values=seen),))
    noise = factor_problems.noise(rng, lasting=False)
    path = solve_problem(problem, noise, rounds=1).linear.path
    *_, (timed, cost) = list_timed_loads(problem, noise, path, loads)
    np.testing.assert_allclose(timed[0].moments, moments, atol=0.06)
    assert cost > 0.0 and {one.moments for one in timed} == {timed[0].moments}


def test_moments_are_found_among_fewer_images_than_the_log_has_parts():
    rng = np.random.default_rng(4)
    problem = factor_problems.drawn(rng, images=28)  # 1.4 s
    loads = tuple(bent(j, (0.7,)) for j in range(2))
    rows = 0.02 * sum(one.moves_links(guess_path(problem).at_images(problem.images[0])) for one in loads)
    (sighting,) = problem.sightings
    seen = sighting.values + np.einsum("dm,fm->fd", sighting.model.a, rows)
    problem = replace(problem, sightings=(replace(sighting, values=seen),))
    noise = factor_problems.noise(rng, lasting=False)
    path = solve_problem(problem, noise, rounds=1).linear.path
    *_, (timed, _) = list_timed_loads(problem, noise, path, tuple(bent(j) for j in range(2)))
    np.testing.assert_allclose(timed[0].moments, (0.7,), atol=0.11)


def test_an_encoder_that_is_off_since_a_moment_is_no_load():
    rng = np.random.default_rng(5)
    problem = factor_problems.drawn(rng, images=64)
    noise = factor_problems.noise(rng, lasting=False)
    after = np.maximum(problem.t - 1.2, 0.0)
    for off in (after > 0.0, after):
        read = problem.values.copy()
        read[:, 1] += 0.03 * off
        one = replace(problem, values=read)
        path = solve_problem(one, noise, rounds=2).linear.path
        found = list(list_timed_loads(one, noise, path, (bent(0), bent(1))))
        assert [timed[0].moments for timed, _ in found] == [ALWAYS]


@pytest.mark.parametrize(
    ("mechanism", "seed", "moments"),
    [
        (SOUND, 7802, (3.0, 6.0, 9.0, 13.0)),
        pytest.param(SOUND, 7801, (8.0,), marks=pytest.mark.soak),
        pytest.param(REALISTIC, 7803, (5.0, 11.0), marks=pytest.mark.soak),
    ],
)
@pytest.mark.soak
def test_what_an_arm_picks_up_is_named_as_a_load_and_no_encoder_is_accused(mechanism, seed, moments):
    fault = Fault(payload=SAG, moments=moments)
    reaches = seed % 2 == 1
    features = mechanisms.replayed(seed, mechanism, fault, reaches=reaches)
    found = estimate_from_features(features, mechanisms.fitted(mechanism), EstimationSettings())
    assert not found.faults
    load = found.settings[HARDWARE_ERRORS]["load"]
    np.testing.assert_allclose(load["moments"], moments, atol=0.6)
    true = links_of(seed, mechanism, fault, reaches)
    error, nees = errors_and_nees(found, true)
    read = np.stack([np.interp(found.joints.t, features.joints.t, one) for one in features.joints.values.T], axis=1)
    apart = read - np.stack([np.interp(found.joints.t, true.t, one) for one in true.values.T], axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(apart**2))
    assert nees < 2.5


@pytest.mark.parametrize(
    ("moments", "words"),
    [
        ([None], "payload: joints"),
        ([8.0], "payload from 8.0 s on: joints"),
        ([None, 8.0], "payload until 8.0 s: joints"),
        ([3.0, 6.1, 9.0], "payload from 3.0 to 6.1 s, from 9.0 s on: joints"),
    ],
)
def test_a_sentence_says_when_a_load_is_carried(moments, words):
    load = {"weight": True, "nats": 20.0, "rad": {"lift": 0.01}, "moments": moments}
    assert describe_load(load).startswith(words)


@pytest.mark.parametrize(
    ("explored", "alone", "beside", "replaced"),
    [
        (1.7e-3, 1.5e-3, 0.8e-3, True),
        (1.7e-3, 1.5e-3, 1.4e-3, False),
        # play that came after the exploration, and play that had taken up a part of the load
        (0.0, 1.5e-3, 0.8e-3, False),
        (1.7e-3, 2.6e-3, 1.7e-3, False),
    ],
)
def test_no_load_stands_for_play_that_the_exploration_had(explored, alone, beside, replaced):
    """A load that came and went as the lift crossed its play won 32 nats."""

    def learned(size):
        return SimpleNamespace(sizes=np.array([2e-3, size]), sizes_cov=1e-8 * np.eye(2))

    problem = SimpleNamespace(columns=(Play("play", 1e-2, joint=0), Play("play", 1e-2, joint=1)))
    halves = np.array([2e-3, explored])
    found = hypotheses._replaces_play(problem, learned(alone), learned(beside), halves)
    assert found == replaced
