"""Figures of merit of estimates over several logs, and tables in Markdown."""

from dataclasses import dataclass

import numpy as np

from bodylog.estimation import estimate_from_features
from bodylog.evaluation.scores import truth_at_times
from bodylog.settings import EstimationSettings
from docs import generate_claims

table = generate_claims.table


@dataclass(frozen=True)
class Found:
    """One estimate beside the truth: errors and standard deviations (N,M) rad at times (N,) s, faults, settings."""

    t: np.ndarray
    error: np.ndarray
    std: np.ndarray
    faults: tuple
    settings: dict

    def within(self, low, high=np.inf):
        """The part between two times (s)."""
        rows = (self.t >= low) & (self.t < high)
        return Found(self.t[rows], self.error[rows], self.std[rows], self.faults, self.settings)

    @property
    def rmse(self):
        """Root mean square error over all joints, rad."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def nees(self):
        """Squared error over stated variance of each joint (M,), 1 where the error bars are true."""
        return np.mean((self.error / self.std) ** 2, axis=0)

    @property
    def coverage(self):
        """Share within two standard deviations."""
        return float(np.mean(np.abs(self.error) <= 2.0 * self.std))


def found(log, body, method="filter", delay="auto", **settings):
    """The estimate of a log, judged by its truth."""
    made = estimate_from_features(log.features, body, EstimationSettings(method=method, **settings), delay)
    names = [name for name in log.truth.names if name in made.joints.names]  # pan, lift, elbow
    columns = [made.joints.names.index(name) for name in names]
    error = made.joints.values[:, columns] - truth_at_times(log.truth, names, made.joints.t)
    std = np.sqrt(np.einsum("nii->ni", made.cov))[:, columns]
    return Found(made.joints.t, error, std, made.faults, made.settings)


def mean_nees(runs):
    """NEES of each joint over logs, with the largest standard error of the three: "0.95, 0.99, 0.99 ± 0.02"."""
    each = np.array([run.nees for run in runs])
    text = joined(each.mean(axis=0))
    return text if len(each) == 1 else f"{text} ± {joined([(each.std(axis=0, ddof=1) / np.sqrt(len(each))).max()])}"


def joined(values):
    """Figures with commas between them, those from ten on without decimals."""
    return ", ".join(f"{value:.2f}" if value < 9.995 else f"{value:.0f}" for value in values)


def rms(values):
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def mrad(runs):
    """Error over all joints and logs, mrad."""
    return f"{1e3 * rms([run.rmse for run in runs]):.3g}"
