"""Runs of the printed model in a reading: its map
from 46 samples, units and touch, on a log's signals.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..body_model import BodyModel
from ..types import Array, Features, Synchrony
from . import readings
from .drawn import ARM, PIXEL_STD, SIZE, place_in_image, px_per_cm
from .lab import JOINTS, ObservedLog
from .printed import DT, Case, Map, Signals, Touching, run_printed_model
from .readings import Reading

Cases = Mapping[str, Case]
SCALE = float(np.exp(0.1))
"""The printed l, rad."""
A_1 = 0.001
"""The printed a_1."""
HAND_STD_PX = 0.3
"""Error of the hand's place where the touched cell's place is known."""
MAX_HAND_AGE_S = 0.2
"""s: a hand last seen longer ago counts as unseen."""


@dataclass(frozen=True, eq=False)
class ExplorationSamples:
    """The printed model's training data: 46 samples x (46,M) rad and their places y (46,2) px."""

    x: Array
    y: Array
    maps: dict[str, Map]

    @property
    def home(self) -> Array:
        """The mean (M,) rad of the explored angles."""
        return np.asarray(self.x.mean(axis=0))

    @property
    def scatter(self) -> float:
        """Standard deviation (px) of the places, over both coordinates."""
        return float(np.sqrt(self.y.var(axis=0).mean()))

    def map(self, reading: Reading) -> Map:
        """The forward model in this reading of σ_n."""
        tried = readings.reading_value(reading, "sigma_n")
        if tried not in self.maps:
            self.maps[tried] = (
                self._learned()
                if tried == "learned"
                else self._printed(readings.reading_number(reading, "sigma_n"))
            )
        return self.maps[tried]

    def _printed(self, noise: float | None) -> Map:
        """l as printed; the mean depends on noise and amplitude
        by their ratio alone, here that of deviations.
        """
        assert noise is not None
        apart = (self.x[:, None] - self.x) / SCALE
        k = np.exp(-0.5 * (apart**2).sum(axis=2)) + noise**2 * np.eye(len(self.x))
        mean = self.y.mean(axis=0)
        return Map(
            self.x,
            np.full(self.x.shape[1], SCALE),
            np.linalg.solve(k, self.y - mean),
            mean,
            self.scatter,
        )

    def _learned(self) -> Map:
        from ..body.gp.fit import samples_without_noise, train_gp

        gp = train_gp(samples_without_noise(self.x, self.y), ("u", "v"), "px")
        return Map(gp.centres, gp.scales[0], gp.amplitude[0] * gp.weights.T, gp.mean, self.scatter)


def explore_by_preset(body: BodyModel) -> ExplorationSamples:
    """The samples of a body learned by the paper's preset."""
    from ..body.gp.model import GP

    model = body.senses["effector"]
    assert isinstance(model, GP)
    return ExplorationSamples(model.samples, model.targets, {})


def drawn_samples(
    seed: int, moving: tuple[bool, bool, bool] = (True, True, True), count: int = 46
) -> ExplorationSamples:
    """An exploration without a recording, for the notebooks:
    `count` drawn postures, noiseless encoders, places.
    """
    rng = np.random.default_rng([seed, 23])
    x = np.array(ARM.home[:3]) + np.array(ARM.swing[:3]) * moving * rng.uniform(
        -1.0, 1.0, (count, 3)
    )
    seen = place_in_image(x) + PIXEL_STD * rng.standard_normal((count, 2))
    return ExplorationSamples(x + 0.003 * rng.standard_normal(x.shape), seen, {})


def build_case(
    known: ExplorationSamples,
    reading: Reading,
    senses: str,
    start: Array,
    touch: bool = False,
    square: bool = False,
) -> Case:
    """One run of senses such as "p1+p3+v" (p: all encoders) from a start (M,) rad."""
    parts = set(senses.split("+"))
    encoders = tuple("p" in parts or f"p{i + 1}" in parts for i in range(len(start)))
    prior = {"belief": start, "home": known.home, "zero": np.zeros(len(start))}[
        readings.reading_value(reading, "mu_x")
    ]
    unit = _unit_px(known, reading, "sigma_v")
    integration = readings.reading_value(reading, "integration")
    felt = _touch_constants(known, reading) if touch or "t" in parts else None
    rate = readings.reading_number(reading, "lambda")
    assert rate is not None
    return Case(
        known.map(reading),
        encoders,
        "v" in parts,
        unit,
        integration,
        start,
        prior,
        felt,
        square,
        rate=rate,
    )


def build_cases(
    known: ExplorationSamples, names: Sequence[str], off: Array | float = 0.0
) -> Callable[[Reading, Signals], Cases]:
    """For `run_study`: a run of each of some senses, from the true start plus `off` (M,) rad."""
    return lambda reading, sensed: {
        name: build_case(known, reading, name, sensed.true[0] + off) for name in names
    }


def _unit_px(known: ExplorationSamples, reading: Reading, name: str) -> float:
    """The unit (px) of a variance or b_1 in a reading."""
    of_log = {
        "standardised": known.scatter,
        "half-widths": SIZE[0] / 2,
        "widths": float(SIZE[0]),
        "cm": px_per_cm(),
    }
    found = readings.reading_number(reading, name)
    return of_log[readings.reading_value(reading, name)] if found is None else found


def _touch_constants(known: ExplorationSamples, reading: Reading) -> Touching:
    a_2, half, relative = (
        readings.reading_number(reading, name) for name in ("a_2", "b_2", "sigma_t")
    )
    assert a_2 is not None and half is not None
    a = A_1 * a_2
    sigma = 1.0 if relative is None else relative * a**2
    b_1 = _unit_px(known, reading, "b_1") ** -2.0
    return Touching(
        a, b_1, float(np.log(2.0)) / half**2, sigma, readings.reading_value(reading, "s_t")
    )


def place_of_touched_skin(body: BodyModel) -> Array:
    """The place of touched skin relative to the effector (2,)
    px, mean of all cells the body knows; 0 without cells.
    """
    places = np.array([place[:2] for place in body.cells.values()])
    return np.asarray(places.mean(axis=0)) if len(places) else np.zeros(2)


def place_hand(sensed: Signals, reading: Reading, by: Array, aside: float, seed: int) -> Signals:
    """The signals with the hand in this reading of o_v.

    by (2,) px: where touched skin is seen beside the effector, in the mean · aside px: the image's
    displacement to the right of the arm, 0 where the hand is seen where it touches.
    """
    where = readings.reading_value(reading, "o_v")
    if where == "hand":
        return sensed
    if where == "stroke":
        return replace(sensed, hand=sensed.hand - by)
    error = HAND_STD_PX * np.random.default_rng([seed, 24]).standard_normal(sensed.hand.shape)
    touched = place_in_image(sensed.true) + np.array([aside, 0.0]) + error
    return replace(sensed, hand=np.where(np.isfinite(sensed.hand), touched, np.nan))


def sample_signals(observed: ObservedLog, joints: Sequence[str] = JOINTS) -> Signals:
    """A log on the printed grid of 20 Hz: nearest
    encoder reading, interpolated place, current touch.
    """
    features = observed.features
    encoders = observed.features.joints
    assert encoders is not None
    t = np.arange(encoders.t[0], encoders.t[-1], DT)
    columns = [encoders.names.index(name) for name in joints]
    hand, delay = _felt_hand(features, t)
    read = encoders.values[_nearest_reading(encoders.t, t)][:, columns]
    return Signals(
        t, read, _interpolate_effector(features, t), hand, delay, observed.true(tuple(joints), t)
    )


def _nearest_reading(t: Array, at: Array) -> Array:
    right = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    return np.asarray(right - (at - t[right - 1] <= t[right] - at))


def _interpolate_effector(features: Features, t: Array) -> Array:
    """The effector's place (N,2) px on the line between
    two frames no more than 0.1 s apart; NaN where unseen.
    """
    track = features.effector
    if track is None or len(track.t) < 2:
        return np.full((len(t), 2), np.nan)
    right = np.clip(np.searchsorted(track.t, t), 1, len(track.t) - 1)
    gap = track.t[right] - track.t[right - 1]
    share = ((t - track.t[right - 1]) / gap)[:, None]
    found = track.values[right - 1] * (1.0 - share) + track.values[right] * share
    return np.where((gap < 0.1)[:, None] & (share >= 0.0) & (share <= 1.0), found, np.nan)


def _felt_hand(features: Features, t: Array) -> tuple[Array, Array]:
    """The hand (N,2) px during touches paired with a
    stroke, and the pair's delay (N,) s; NaN otherwise.
    """
    hand = np.full((len(t), 2), np.nan)
    delay = np.full(len(t), np.nan)
    if features.hand is None or not len(features.hand.t):
        return hand, delay
    rows = np.maximum(np.searchsorted(features.hand.t, t + 1e-9, "right") - 1, 0)
    fresh = t - features.hand.t[rows] < MAX_HAND_AGE_S
    for pair in features.synchrony:
        now = _times_during_touch(features, pair, t) & fresh
        hand[now] = features.hand.values[rows[now]]
        delay[now] = pair.delay
    return hand, delay


def _times_during_touch(features: Features, pair: Synchrony, t: Array) -> Array:
    touch = (features.touches or ())[pair.touch]
    return np.asarray((t >= touch.onset) & (t <= touch.offset))


@dataclass(frozen=True, eq=False)
class StudyBeliefs:
    """The beliefs of one reading's runs: signals · x
    {name: (N,M) rad} · errors {name: e_p, e_v (N,M+2)}.
    """

    signals: Signals
    x: Mapping[str, Array]
    errors: Mapping[str, Array]

    def error(self, name: str, since: float) -> float:
        """Root mean square error (rad) of a run from `since` s on; NaN when it diverged."""
        return self.signals.error(self.x[name], since)


def run_study(
    tried: Sequence[Reading],
    log: Callable[[Reading], Signals],
    cases: Callable[[Reading, Signals], Cases],
) -> dict[str, StudyBeliefs]:
    """The beliefs of all readings' runs, by the reading's key; those on one log run together."""
    groups: dict[int, list[tuple[str, Signals, Cases]]] = {}
    for reading in tried:
        sensed = log(reading)
        groups.setdefault(id(sensed), []).append(
            (readings.reading_key(reading), sensed, cases(reading, sensed))
        )
    found: dict[str, StudyBeliefs] = {}
    for members in groups.values():
        sensed = members[0][1]
        made = run_printed_model(sensed, [case for _, _, of in members for case in of.values()])
        runs = iter(zip(made.x, made.errors, strict=True))
        for name, _, of in members:
            mine = {run: next(runs) for run in of}
            found[name] = StudyBeliefs(
                sensed, {k: x for k, (x, _) in mine.items()}, {k: e for k, (_, e) in mine.items()}
            )
    return found
