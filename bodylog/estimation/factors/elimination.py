"""The whole problem as one banded matrix with a border, eliminated from the first knot to the last.

All factors have the form ½ x'Ax − x'U c + ½ c'W c + logs, with c = (1, −g) and g the columns'
sizes. Without the states

    ½ c'(W − U'A⁻¹U) c + ½ ln |A|,

so a column's gain is a Schur complement. Eliminating knot by knot
leaves at each knot what all before it say: the filter. Adding what all
after it say gives the smoother: both are read from one Cholesky factor.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...linear_algebra import selected_inverse
from ...motion import band_storage
from ...types import Array
from .condensing import PairFactors
from .encoder_error import JointNoise


@dataclass(frozen=True, eq=False)
class System:
    """Factors on K knots of S states: own at a knot, pair
    from each to the next; R−1 columns, with their precision.

    info (K,S,S), right (K,S,R), square (K,R,R), logs (K,): at knots · pair_info (K-1,2S,2S),
    pair_right (K-1,2S,R), pair_square (K-1,R,R), pair_logs (K-1,) · means, precision (C,): of the
    columns' sizes before the log. The first right-hand side is about the means · joints: the
    factors that pairs are made of · settled (C,C): covariance of sizes that are known
    about their means, and that are not learned again.
    """

    info: Array
    right: Array
    square: Array
    logs: Array
    pair_info: Array
    pair_right: Array
    pair_square: Array
    pair_logs: Array
    means: Array
    precision: Array
    joints: PairFactors
    settled: Array | None = None

    def subtract_means(self) -> "System":
        """The same with the means of the columns' sizes in the
        first right-hand side, which is given without them.
        """
        if not self.means.any():
            return self
        turn = np.eye(1 + len(self.means))
        turn[1:, 0] = -self.means
        return replace(
            self,
            right=self.right @ turn,
            square=turn.T @ self.square @ turn,
            pair_right=self.pair_right @ turn,
            pair_square=turn.T @ self.pair_square @ turn,
        )

    @property
    def state_count(self) -> int:
        """Number S of states at a knot."""
        return int(self.info.shape[1])

    def assemble_blocks(self) -> tuple[Array, Array, Array]:
        """Diagonal (K,S,S) and upper (K-1,S,S) blocks of A, and U (K,S,R)."""
        s = self.state_count
        diagonal = self.info.copy()
        diagonal[:-1] += self.pair_info[:, :s, :s]
        diagonal[1:] += self.pair_info[:, s:, s:]
        right = self.right.copy()
        right[:-1] += self.pair_right[:, :s]
        right[1:] += self.pair_right[:, s:]
        return diagonal, self.pair_info[:, :s, s:], right


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Cholesky factor of A in LAPACK's upper band storage,
    its diagonal blocks (K,S,S), and U' (K,S,R) eliminated.

    schur (R,R): what is left of c · nats: the rest, without c.
    """

    band: Array
    factors: Array
    right: Array
    schur: Array
    logs: float
    precision: Array

    @property
    def nats(self) -> float:
        """−ln p of all measurements, with the columns' sizes integrated out."""
        return self.logs + float(compute_column_nats(self.schur[None], self.precision)[0])


def eliminate_states(system: System) -> Eliminated:
    """Eliminate all states; LinAlgError if A is not positive definite."""
    from scipy.linalg.lapack import dpbtrf, dtbtrs

    diagonal, upper, right = system.assemble_blocks()
    count, s, r = right.shape
    band, failed = dpbtrf(band_storage(diagonal, upper), lower=0)
    if failed:
        raise np.linalg.LinAlgError("the factors on the states are singular")
    solved, _ = dtbtrs(band, right.reshape(-1, r), uplo="U", trans="T")
    factors = np.zeros((count, s, s))
    for i in range(s):
        for j in range(i, s):
            factors[:, i, j] = band[2 * s - 1 - (j - i), j::s]
    schur = system.square.sum(axis=0) + system.pair_square.sum(axis=0) - solved.T @ solved
    logs = float(system.logs.sum() + system.pair_logs.sum() + np.log(band[-1]).sum())
    return Eliminated(band, factors, solved.reshape(count, s, r), schur, logs, system.precision)


def compute_column_nats(schur: Array, precision: Array) -> Array:
    """−ln p (K,) of what is left of c (K,R,R), with g integrated out."""
    square = 0.5 * schur[:, 0, 0]
    if not len(precision):
        return np.asarray(square)
    posterior = schur[:, 1:, 1:] + np.diag(precision)
    size = np.linalg.solve(posterior, schur[:, 1:, :1])[..., 0]
    gain = 0.5 * np.einsum("kc,kc->k", schur[:, 1:, 0], size)
    logs = 0.5 * (np.linalg.slogdet(posterior)[1] - np.log(precision).sum())
    return np.asarray(square - gain + logs)


@dataclass(frozen=True, eq=False)
class Marginals:
    """Beliefs at K knots: state (K,S) and cov (K,S,S)
    · sizes (K,C) of the columns and their cov (K,C,C).

    shared (K,S,C): X₁ of the states X₀ − X₁ g · nats (K,) or
    (): −ln p of all measurements up to the knot, or of all.
    """

    mean: Array
    cov: Array
    sizes: Array
    sizes_cov: Array
    shared: Array
    nats: Array | float

    def split_joints(self, joints: JointNoise) -> Array:
        """Each joint's state (K,M,p) at the knots."""
        width = len(joints.white) * joints.state_count
        return self.mean[:, :width].reshape(len(self.mean), -1, joints.state_count)

    def list_angle_variances(self, joints: JointNoise) -> Array:
        """Variances (K,M) rad² of the joints' angles at the knots, the columns' sizes known."""
        width = len(joints.white) * joints.state_count
        return np.asarray(np.einsum("kss->ks", self.cov)[:, : width : joints.state_count])

    def project_rows(self, rows: Array, knots: Array, columns: Array) -> tuple[Array, Array]:
        """Mean (F,D) and covariance (F,D,D) of rows (F,D,S)
        on the states at knots (F,), and columns (F,D,C).
        """
        mean, own, by_sizes = self.split_rows(rows, knots, columns)
        return mean, own + by_sizes

    def split_rows(self, rows: Array, knots: Array, columns: Array) -> tuple[Array, Array, Array]:
        """As of `project_rows`, the covariance with the columns' sizes known, and that by these."""
        mean = np.einsum("fds,fs->fd", rows, self.mean[knots])
        mean = mean + np.einsum("fdc,fc->fd", columns, self.sizes[knots])
        # x = X₀ − X₁ g: a size moves the states as well
        moved = columns - rows @ self.shared[knots]
        own = rows @ (self.cov[knots] @ rows.swapaxes(1, 2))
        return mean, own, moved @ self.sizes_cov[knots] @ moved.swapaxes(1, 2)


@dataclass(frozen=True, eq=False)
class Smoothed(Marginals):
    """Beliefs by the whole log; between (K-1,S,S):
    covariances of neighbouring states, the sizes known.
    """

    between: Array


def smooth_knots(system: System, eliminated: Eliminated) -> Smoothed:
    """What the whole log says at each knot; `cov` is that with the columns' sizes known."""
    from scipy.linalg.lapack import dtbtrs

    count, s, r = eliminated.right.shape
    paths, _ = dtbtrs(eliminated.band, eliminated.right.reshape(-1, r), uplo="U")
    paths = paths.reshape(count, s, r)
    diagonal, upper, _ = system.assemble_blocks()
    cov, between = selected_inverse(diagonal, upper)
    if system.settled is None:
        sizes_cov = np.linalg.inv(eliminated.schur[1:, 1:] + np.diag(system.precision))
        sizes = sizes_cov @ eliminated.schur[1:, 0]
    else:
        sizes_cov = system.settled
        sizes = np.zeros(r - 1)
    mean = paths[..., 0] - paths[..., 1:] @ sizes
    return Smoothed(
        mean,
        cov,
        np.repeat((sizes + system.means)[None], count, axis=0),
        np.repeat(sizes_cov[None], count, axis=0),
        paths[..., 1:],
        eliminated.nats,
        between,
    )


def filter_knots(system: System, eliminated: Eliminated) -> Marginals:
    """What all measurements up to each knot say there."""
    return _solve_forward(system, eliminated, system.info, system.right, system.square, system.logs)


def predict_knots(system: System, eliminated: Eliminated) -> Marginals:
    """What all measurements before each knot say there;
    at the first, the prior that its first factor holds.
    """
    own = (system.info, system.right, system.square, system.logs)
    first = (np.concatenate([part[:1], np.zeros_like(part[1:])]) for part in own)
    return _solve_forward(system, eliminated, *first)


def _solve_forward(
    system: System, eliminated: Eliminated, info: Array, right: Array, square: Array, logs: Array
) -> Marginals:
    """The forward Schur blocks with the knots' own factors
    given; what is behind comes from the elimination.
    """
    count, s, r = eliminated.right.shape
    factors = eliminated.factors
    diagonal, _, whole_right = system.assemble_blocks()
    # what is eliminated before a knot changes its block from the one in A to the one in the factor
    behind = factors.swapaxes(1, 2) @ factors - diagonal
    behind[1:] += system.pair_info[:, s:, s:]
    behind_right = factors.swapaxes(1, 2) @ eliminated.right - whole_right
    behind_right[1:] += system.pair_right[:, s:]
    own_info = info + behind
    own_right = right + behind_right
    inverse, log_det = _invert_scaled(own_info)
    paths = inverse @ own_right
    done = np.einsum("ksr,ksq->krq", eliminated.right, eliminated.right)
    passed = np.zeros((count, r, r))
    passed[1:] = np.cumsum(system.square[:-1] + system.pair_square - done[:-1], axis=0)
    schur = passed + square - own_right.swapaxes(1, 2) @ paths
    pivots = np.log(np.einsum("kss->ks", factors)).sum(axis=1)
    gone = np.zeros(count)
    gone[1:] = np.cumsum(system.logs[:-1] + system.pair_logs + pivots[:-1])
    nats = gone + logs + 0.5 * log_det
    if system.settled is None:
        nats = nats + compute_column_nats(schur, system.precision)
        sizes_cov = np.linalg.inv(schur[:, 1:, 1:] + np.diag(system.precision))
        sizes = (sizes_cov @ schur[:, 1:, :1])[..., 0]
    else:
        nats = nats + 0.5 * schur[:, 0, 0]
        sizes_cov = np.repeat(system.settled[None], count, axis=0)
        sizes = np.zeros((count, r - 1))
    mean = paths[..., 0] - np.einsum("ksc,kc->ks", paths[..., 1:], sizes)
    return Marginals(mean, inverse, sizes + system.means, sizes_cov, paths[..., 1:], nats)


def _invert_scaled(info: Array) -> tuple[Array, Array]:
    """Inverses (K,S,S) and ln determinants (K,), scaled to a unit diagonal first."""
    scale = 1.0 / np.sqrt(np.einsum("kss->ks", info))
    scaled = info * scale[:, :, None] * scale[:, None, :]
    inverse = np.linalg.inv(scaled) * scale[:, :, None] * scale[:, None, :]
    log_det = np.linalg.slogdet(scaled)[1] - 2.0 * np.log(scale).sum(axis=1)
    return inverse, log_det
