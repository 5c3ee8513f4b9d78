"""The table of methods, one line each."""

from collections.abc import Mapping

from .contract import Method
from .filtering import EKF, LAPLACE
from .kalman import METHOD as KALMAN
from .predictive_coding import METHOD as PREDICTIVE_CODING
from .smoother import METHOD as SMOOTHER

METHODS: Mapping[str, Method] = {
    "laplace": LAPLACE,
    "smoother": SMOOTHER,
    "ekf": EKF,
    "kalman": KALMAN,
    "predictive-coding": PREDICTIVE_CODING,
}
