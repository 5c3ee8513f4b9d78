"""The live filter for any learned body, including
bodies whose encoders read a function of the angle.
"""

from collections.abc import Mapping
from typing import Any

from .body.senses import encoder_function
from .body_model import BodyModel
from .estimation.inference.reacquisition import LONG_SILENCE_S
from .estimation.live import Angles, Belief, LiveEstimator, Place, require_finite_time
from .estimation.measurements.track import camera_of_track
from .estimation.timing import correction
from .settings import EstimationSettings


class Estimator(LiveEstimator):
    """A filter fed as readings arrive: `est.step(t, joints=…,
    effector=…)`; noise is the body's own, or a log's.
    """

    def __init__(
        self,
        body: BodyModel,
        settings: EstimationSettings | None = None,
        lag: float = LONG_SILENCE_S,
        delay: Mapping[str, float] | None = None,
        learned: Mapping[str, Any] | None = None,
    ) -> None:
        """A filter for `body` with the senses, start and bias
        of `settings`; readings may be up to `lag` s late.

        `delay`: how far (s) each camera's timestamps lag, {name: s}; None: as in the body's
        exploration log · `learned`: settings of an estimate, whose variances are used. UsageError
        for settings that need the whole log, for variances of another body, and where a reading
        does not determine the angle.
        """
        # refuses zero slopes, by which `plain` divides
        to_angles = encoder_function.angle_reader(body)
        super().__init__(encoder_function.body_for_angles(body), settings, lag, to_angles, learned)
        cameras = correction.list_track_cameras(body.senses)
        self._delays = (
            correction.read_learned_delays(body)
            if delay is None
            else correction.select_fixed_delays(delay, cameras)
        )

    def step(self, t: float, joints: Angles | None = None, **places: Place | None) -> Belief:
        """The belief after all readings stamped t (s): joints in rad, places (u, v) or (u, v,
        std_u, std_v) in px, or (x, y, z), with their std, in m.

        None, or NaN, is a missing reading. Readings may arrive out of order by up to `lag` s; the
        belief is about the latest instant. UsageError or ModelError for readings that do not fit
        the body, LogError until every joint has been read once.
        """
        t = require_finite_time(t)
        by_delay = dict[float, dict[str, Place | None]]()
        own = self._delays.get("joints", 0.0)
        if joints is not None or not places:
            by_delay[own] = {}
        for name, place in places.items():
            by = 0.0 if name == "touch" else self._delays.get(camera_of_track(name), 0.0)
            by_delay.setdefault(by, {})[name] = place
        return self._step_together(
            [(t - by, joints if by == own else None, given) for by, given in by_delay.items()]
        )
