"""Stage: body. What the robot should see, learned from exploration logs."""

from .encoders import Polynomial
from .learn import Learned, learn

__all__ = ["Learned", "Polynomial", "learn"]
