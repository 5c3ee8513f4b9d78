"""One instant of the filter, by the kernel that filters whole logs (scan.c)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...types import Array
from .filter_records import FilterDynamics, FilterReadings
from .instant import Line
from .scan import allocate_trace, prepare_filter


class SteppedBelief(NamedTuple):
    """The belief z (K,), p (K,K) after an instant, and x
    (M,) rad, cov (M,M) of the angles before its readings.

    d (M,): innovations of the encoders, in standard
    deviations, NaN where silent · nats of all readings.
    """

    z: Array
    p: Array
    x: Array
    cov: Array
    d: Array
    nats: float


class FilterStep:
    """The belief from an instant to the next, by the
    encoders and by lines of T tracks with up to D rows.
    """

    def __init__(self, dynamics: FilterDynamics, tracks: int = 0, rows: int = 0) -> None:
        """Dynamics with process (M,). All arrays stay
        where they are, so that a call only fills them.
        """
        m = len(dynamics.process)
        k = dynamics.size
        n = k // m
        self._dynamics, self._z, self._p = dynamics, np.empty((k, 1)), np.empty((k, k, 1))
        self._leaps = np.empty((1, n, n, m, 1)), np.empty((1, n, m, 1)), np.empty((1, n, n, m, 1))
        self._lost, self._more = np.empty((1, m, 1), bool), np.empty((1, m, 1))
        self._readings = FilterReadings(
            np.empty((1, 1)),
            np.empty((1, m, 1)),
            np.empty((1, m, 1)),
            np.empty((1, tracks, rows, 1)),
            np.empty((1, tracks, rows, m, 1)),
            np.empty((1, tracks, rows, 1)),
            reset=self._lost,
            more=self._more,
            moves=self._leaps,
        )
        self._trace = allocate_trace(self._readings, dynamics, 1)
        self._run = prepare_filter(self._readings, dynamics, self._z, self._p, self._trace)

    def __call__(
        self,
        z: Array,
        p: Array,
        dt: float,
        encoders: Sequence[float] | Array,
        var: Sequence[float] | Array,
        lines: Sequence[Line] = (),
        *,
        lost: Array | None = None,
        held: Array | None = None,
        more: Array | None = None,
    ) -> SteppedBelief:
        """The belief dt (s) after z (K,), p (K,K), given readings
        (M) rad, NaN where silent, with variances var (M).

        lines: one for each track · lost (M,) bool: joints that restart ·
        held (M,) bool: joints silent for long · more (M,): factor on the
        process variance. LinAlgError where rounding leaves no number.
        """
        to = self._readings
        trace = self._trace
        self._z[:, 0], self._p[..., 0], to.dt[0] = z, p, dt
        to.encoders[0, :, 0], to.encoder_var[0, :, 0] = encoders, var
        self._lost[0, :, 0], self._more[0, :, 0] = (
            False if lost is None else lost,
            1.0 if more is None else more,
        )
        self._leaps[0][:] = np.nan
        if held is not None and self._dynamics.stationary is not None:
            for part, found in zip(
                self._leaps, self._dynamics.moves(np.array([dt]), held[None]), strict=True
            ):
                part[..., 0] = found
        to.y[:], to.jac[:], to.var[:] = np.nan, 0.0, 1.0
        for track, line in enumerate(lines):
            n = len(line.y)
            to.y[0, track, :n, 0], to.jac[0, track, :n, :, 0], to.var[0, track, :n, 0] = (
                line.y,
                line.jac,
                line.var,
            )
        self._run()
        if not np.isfinite(nats := trace.nats.item()):
            raise np.linalg.LinAlgError("rounding leaves no number")
        after = trace.z[0], trace.end_p, trace.prior[0], trace.prior_cov[0], trace.encoder_d[0]
        z, p, x, cov, d = (part[..., 0].copy() for part in after)
        return SteppedBelief(z, p, x, cov, d, nats)
