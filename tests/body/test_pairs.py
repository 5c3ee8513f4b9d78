from dataclasses import replace

import numpy as np
import pytest

from bodylog.body.data.pairs import (
    correlate_angle_errors,
    has_moved,
    pair_sightings,
    smooth_all_joints,
)
from bodylog.errors import ConfigError, LogError


@pytest.mark.parametrize("encoder", [0.0, 0.0005, 0.02])
def test_joints_with_noise_alone_do_not_move(explored, encoder: float) -> None:
    found = smooth_all_joints([explored(0, encoder, 20.0).features], None)
    assert [j.name for j in found if has_moved(j)] == ["pan", "lift", "elbow"]


def test_wanted_joints_come_in_the_order_wanted(explored) -> None:
    features = explored(0, 0.001, 10.0).features
    assert [j.name for j in smooth_all_joints([features], ("elbow", "wrist"))] == ["elbow", "wrist"]
    with pytest.raises(ConfigError, match=r"\[body\] joints: found 'elbo', possible: pan, lift, elbow, wrist"):
        smooth_all_joints([features], ("elbo",))


def test_joints_names_a_log_without_readings(explored) -> None:
    features = explored(0, 0.001, 10.0).features
    with pytest.raises(LogError, match="log 2 of 2: no joint readings"):
        smooth_all_joints([features, replace(features, joints=None)], None)


@pytest.mark.parametrize("seed", range(3))
def test_angles_beside_sightings_are_better_than_readings_with_true_variance(explored, seed: int) -> None:
    run = explored(seed, 0.02, 20.0)
    chosen = smooth_all_joints([run.features], ("pan", "lift", "elbow"))
    part = pair_sightings([run.features], "effector", chosen, 1)
    error = part.x - run.angles[np.searchsorted(run.features.effector.t, part.t)]
    assert np.sqrt(np.mean(error**2)) < 0.006
    assert 0.5 < np.mean(error**2 / part.variance) < 1.6


def test_only_sightings_with_angles_are_paired(explored) -> None:
    features = explored(0, 0.001, 10.0).features
    track = features.tracks["effector"]
    values = track.values.copy()
    values[3:7] = np.nan
    late = replace(features, tracks={"effector": replace(track, values=values, t=track.t - 0.1)})
    chosen = smooth_all_joints([late], ("pan", "lift", "elbow"))
    twice = [replace(j, angles=j.angles * 2) for j in chosen]
    part = pair_sightings([late, features], "effector", twice, 1)
    assert part.frames == 2 * len(track.t)
    assert len(part.x) == 2 * len(track.t) - 4 - 1
    assert np.isfinite(part.x).all() and set(part.log) == {0, 1}
    assert len(set(part.block)) == 20


@pytest.mark.parametrize("part", [slice(None), slice(0, 1)])
def test_sightings_in_long_encoder_gaps_are_dropped(explored, part: slice) -> None:
    features = explored(0, 0.003, duration=20.0).features
    readings = features.joints
    assert readings is not None
    values, silent = readings.values.copy(), (readings.t > 6.0) & (readings.t < 13.0)
    values[silent, part] = np.nan
    fewer = replace(features, joints=replace(readings, values=values))
    found = pair_sightings([fewer], "effector", smooth_all_joints([fewer], ("pan", "lift", "elbow")), 1)
    within = (found.t > 8.5) & (found.t < 10.5)
    assert not within.any() and len(found.t) > 120
    assert np.isin(found.t, features.tracks["effector"].t).all()


def test_pairs_keeps_every_nth_frame(explored) -> None:
    features = explored(0, 0.001, 10.0).features
    part = pair_sightings([features], "effector", smooth_all_joints([features], ("pan",)), 3)
    assert np.allclose(part.t, features.effector.t[::3])


def test_coupling_stays_within_a_log(explored) -> None:
    features = explored(0, 0.01, 8.0).features
    chosen = smooth_all_joints([features, features], ("pan", "lift"))
    part = pair_sightings([features, features], "effector", chosen, 1)
    found = correlate_angle_errors(part, chosen)
    assert (part.log[found.i] == part.log[found.j]).all() and (found.i > found.j).all()
    assert (np.abs(found.value) <= part.variance.max()).all() and set(found.joint) == {0, 1}
