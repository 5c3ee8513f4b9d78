"""What a body without a URDF knows of postures that its exploration did not reach: the axes of the joints, found from
the marker's track, against a Gaussian process alone."""

from dataclasses import replace

import numpy as np

from bodylog import body
from bodylog.settings import BodySettings, Settings
from tests.validation import figures, logs

SHARES = (0.05, 0.1, 0.2, 0.4, 1.0)
SEEDS = range(600, 606)
ENCODER_STD = 0.001


def table():
    """A row for each share of the whole motion that the exploration makes."""
    head = (f"share of the motion ({len(SEEDS)} explorations)", *("error, px", "z²") * 2, "with axes")
    return figures.table(head, [row(share) for share in SHARES])


def row(share):
    """Errors (px) and squared errors over stated variances on the whole motion: process alone, with axes."""
    found = [judge(seed, share) for seed in SEEDS]
    errors = np.array([each for each, _ in found])
    cells = [f"{value:.2f}" for value in np.median(errors, axis=0).reshape(-1)]
    return f"{share:g}", *cells, f"{sum(better for _, better in found)} of {len(found)}"


def judge(seed, share):
    """((error, z²) of the process alone and with axes), and whether there are axes."""
    features = explored(seed, share)
    settings = Settings(body=BodySettings(joints=logs.JOINTS))
    alone = body.learn_body([features], settings, {})
    both = body.with_kinematics([features], settings, alone, None)
    x = logs.drawn("babble", seed + 100, 40.0).truth.values[::20]
    true = logs.eyes()[0].place(x)
    models = [one.model.senses["effector"] for one in (alone, both)]
    return [over(model, x, true) for model in models], models[0] is not models[1]


def over(model, x, true):
    """RMS error (px) and mean squared error over the stated variance."""
    mean, _, variance = model.predict(x)
    away = np.square(mean - true)
    return float(np.sqrt(away.mean())), float((away / variance).mean())


def explored(seed, share):
    """A motion of this share of the whole one about its middle, with the noise of encoders and images."""
    rng = np.random.default_rng([seed, 17])
    log = logs.drawn("babble", seed, 40.0)
    truth, joints, track = log.truth, log.features.joints, log.features.tracks["effector"]
    middle = truth.values.mean(axis=0)
    angles = middle + share * (truth.values - middle)
    values = joints.values.copy()
    values[:, [joints.names.index(name) for name in truth.names]] = angles
    values += ENCODER_STD * rng.standard_normal(values.shape)
    there = np.column_stack([np.interp(track.t, truth.t, column) for column in angles.T])
    seen = logs.perceived(logs.eyes()[0].place(there), rng)
    tracks = {"effector": replace(track, values=seen)}
    return replace(log.features, joints=replace(joints, values=values), tracks=tracks)
