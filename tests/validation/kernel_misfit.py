"""Squared error over the kernel's own variance, before MISFIT is applied."""

from dataclasses import replace

import numpy as np

from bodylog import body
from bodylog.body.gp.fit import samples_without_noise, train_gp
from bodylog.body.gp.model import MISFIT
from bodylog.settings import BodySettings, Settings
from bodylog.sim.scenarios import SCENARIOS
from tests.validation import figures, logs

COUNT, SECONDS = 6, 60.0
"""Explorations of a row, and their length in s."""


def table():
    """A row for each thing learned from; mean and standard error over the explorations."""
    found = {name: [ratio(seed) for seed in range(COUNT)] for name, ratio in KINDS.items()}
    rows = []
    for name, ratios in found.items():
        mean, error = np.mean(ratios, axis=0), np.std(ratios, axis=0, ddof=1) / np.sqrt(COUNT)
        rows.append((name, *(f"{m:.2f} ± {e:.2f}" for m, e in zip(mean, error, strict=True))))
    return figures.table((f"learned from ({COUNT} explorations)", "reach", "explored"), rows)


def of_log(noise):
    """What `learn` makes of a log whose encoders have this noise (rad)."""

    def ratio(seed):
        log, elsewhere = explored(seed, noise), angles(seed)
        model = body.learn_body([log.features], Settings(body=BodySettings(joints=logs.JOINTS)), {}).model.senses["effector"]
        return [over(model, x, true(x)) for x in (elsewhere, at_frames(log))]

    return ratio


def of_angles(seed):
    """What the same places teach at true angles."""
    log = explored(seed, 0.003)
    x, places = at_frames(log), log.features.tracks["effector"].values
    model = train_gp(samples_without_noise(x, places), ("u", "v"), "px")
    return [over(model, one, true(one)) for one in (angles(seed), x)]


KINDS = {
    "the log, encoders of 0.003 rad": of_log(0.003),
    "the log, encoders of 0.02 rad": of_log(0.02),
    "the same places at true angles": of_angles,
}


def explored(seed, noise):
    """An exploration of the simulated arm."""
    return logs.drawn("babble", seed, SECONDS, plan=lambda asked: replace(SCENARIOS["babble"].plan(asked), noise=noise))


def angles(seed):
    """True angles (N,3) rad along a reach."""
    return logs.drawn("reach", 1000 + seed, 20.0).truth.values[::10]


def at_frames(log):
    """True angles (N,3) rad at the images."""
    return log.true(logs.JOINTS, log.features.tracks["effector"].t)


def true(x):
    """True places (N,2) px."""
    return logs.eyes()[0].place(x)


def over(model, x, places):
    """Squared error over the kernel's own variance."""
    mean, _, var = model.predict(x)
    return float(np.mean((mean - places) ** 2 / (var / MISFIT)))
