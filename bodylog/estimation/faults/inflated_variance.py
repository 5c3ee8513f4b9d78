"""A forward model whose errors include those of a correction that all its measurements share."""

from typing import Any

from ...body_model import ForwardModel
from ...types import Array


class InflatedVariance:
    """A forward model with added variance (D,) unit²; otherwise the plain model."""

    def __init__(self, plain: ForwardModel, added: Array) -> None:
        """Wrap a plain model."""
        self._plain, self._added = plain, added

    def __getattr__(self, name: str) -> Any:
        """An attribute of the plain model."""
        if name.startswith("__") or name == "_plain":
            raise AttributeError(name)
        return getattr(self._plain, name)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the D outputs."""
        return self._plain.outputs

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at x (N,M) rad: mean (N,D) · Jacobian (N,D,M) per rad · variance (N,D)."""
        mean, jac, var = self._plain.predict(x)
        return mean, jac, var + self._added
