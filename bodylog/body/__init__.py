"""Stage: body. What the robot should see, learned from exploration logs."""

from .learn import Learned, learn

__all__ = ["Learned", "learn"]
