"""Beside a live robot: the filter for any learned body, also where encoders read a function of the angle."""

from .body import encoders
from .estimation import streaming
from .settings import Estimation
from .types import BodyModel


class Estimator(streaming.Estimator):
    """A filter fed as readings come: `est.step(t, joints=…, effector=…)`; noise is the body's own."""

    def __init__(self, body: BodyModel, settings: Estimation | None = None, lag: float = streaming.LAG) -> None:
        """A filter for `body` with the senses, start and bias of `settings`; what comes up to `lag` s late is heard.

        UsageError for settings that need the whole log, and where a reading does not tell the angle.
        """
        tell = encoders.teller(body)  # refuses where a slope vanishes, by which plain divides
        super().__init__(encoders.plain(body), settings, lag, tell)
