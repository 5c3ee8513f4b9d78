"""Images as linear factors on the states at knots.

An image of a link at the angles l shows h(l), with the noise of the image and the error of the
learned model, which is the same for the same posture. Linearised at l₀:

    z − h(l₀) + J l₀ = J l + s u + n,    l = stands · state + Σ C g,
    u_k = κ_k u_{k−1} + √(1 − κ²) ν,

with s² the model's variance and κ = exp(−½ |Δq / reach|) by the step of the posture. The model's
error correlates by exp(−½ |Δq / reach|²), but a chain multiplies what its steps keep: small ones
would keep all of it for ever. κ keeps as much over one reach, in however many steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...types import Array
from ..measurements.long_arrays import find_finite_rows
from ..measurements.records import Sighting, mix_rows
from ..noise.correlated_noise import read_correlation_length
from .condensing import SAME_TIME_S
from .encoder_error import JointNoise
from .robust import LEAST_SHARE


@dataclass(frozen=True, eq=False)
class Images:
    """F images of one sense at knots (F,), `ahead` (F,) s
    after them: values and stated variance (F,D), mix (F,D,D).

    believed (F,): share that is not taken for an outlier.
    """

    sighting: Sighting
    frames: Array
    knots: Array
    ahead: Array
    values: Array
    var: Array
    mix: Array | None
    believed: Array


@dataclass(frozen=True, eq=False)
class ImageRows:
    """Images as rows on the state of their knots: slopes
    (F,D,S) · right (F,D,R) · var (F,D) of their noise.
    """

    slopes: Array
    right: Array
    var: Array


def place_images(sighting: Sighting, knots: Array, nearest: bool) -> Images:
    """The images of a sense that show it, at the knots (K,)
    s: the nearest, or the first that is not before them.
    """
    values, var, mix = sighting.independent_rows
    within = sighting.t <= knots[-1] + SAME_TIME_S
    frames = np.flatnonzero(find_finite_rows(values) & within)
    t = sighting.t[frames]
    own = find_nearest_knots(t, knots) if nearest else find_next_knots(t, knots)
    own_mix = None if mix is None else mix[frames]
    ones = np.ones(len(frames))
    return Images(sighting, frames, own, t - knots[own], values[frames], var[frames], own_mix, ones)


def find_next_knots(t: Array, knots: Array) -> Array:
    """Numbers (N,) of the first knots (K,) s that are not before times t (N,) s, or of the last."""
    return np.minimum(np.searchsorted(knots, t - SAME_TIME_S), len(knots) - 1)


def find_nearest_knots(t: Array, knots: Array) -> Array:
    """Numbers (N,) of the knots (K,) s nearest to times t (N,) s."""
    after = find_next_knots(t, knots)
    before = np.maximum(after - 1, 0)
    return np.where(t - knots[before] < knots[after] - t, before, after)


def build_image_rows(
    images: Images,
    links: Array,
    noise: JointNoise,
    columns: Array,
    displaced: Array,
    first: int,
    size: int,
) -> ImageRows:
    """Rows of images, linearised at the links' angles (F,M) rad.

    columns (F,M,C): what each column of the border moves a link by · displaced (F,D,C): what
    it displaces the sense's own rows by beside · first, size: place of this sense's model error in
    a state, and the state's length S.
    """
    mean, jac, model_var = mix_rows(images.mix, images.sighting.model.predict(links))
    count, rows, joints = jac.shape
    slopes = np.zeros((count, rows, size))
    width = joints * noise.state_count
    by_states = jac[..., None] * noise.build_link_rows(images.ahead)[:, None]
    slopes[..., :width] = by_states.reshape(count, rows, width)
    slopes[:, np.arange(rows), first + np.arange(rows)] = np.sqrt(np.maximum(model_var, 0.0))
    read = images.values - mean + np.einsum("fdm,fm->fd", jac, links)
    own = displaced if images.mix is None else images.mix @ displaced
    moved = np.einsum("fdm,fmc->fdc", jac, columns) + own
    return ImageRows(slopes, np.concatenate([read[..., None], moved], axis=-1), images.var)


def correlate_model_errors(sightings: Sequence[Sighting], links: Array) -> Array:
    """Correlation κ (K-1,U) of the model errors of all
    senses' rows from knot to knot, for links (K,M) rad.
    """
    step = np.diff(links, axis=0)
    found = [
        np.repeat(
            np.exp(-0.5 * np.linalg.norm(step / read_correlation_length(one.model), axis=-1))[
                :, None
            ],
            one.values.shape[1],
            axis=1,
        )
        for one in sightings
    ]
    both = np.concatenate(found, axis=1) if found else np.zeros((len(step), 0))
    # at rest it would be 1, which has no inverse
    return np.minimum(both, 1.0 - LEAST_SHARE)
