"""What to track when nothing is configured and the default
colour is not on the arm: what moves with the joints.
"""

from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...settings import Settings, hand_colour
from ...types import Features, Recording, Series
from . import candidates, joint_motion
from .candidates import FeatureSurvey

_ENOUGH = 200
_FEWEST = 50
_RARELY = 0.05
_CLEARLY = 0.5


class Alternative(NamedTuple):
    """Why the effector's track is not on the arm, and what else the images show."""

    why: str
    survey: FeatureSurvey


def find_alternative(
    recording: Recording, features: Features, settings: Settings
) -> Alternative | None:
    """What else a recording shows if the effector's track is not on the arm; None if it may be."""
    effector = features.effector
    size = features.picture_size
    if (
        effector is None
        or size is None
        or not (why := _reason_not_on_arm(recording, effector, size[0]))
    ):
        return None
    try:
        return Alternative(
            why,
            candidates.survey_features(
                recording, hand_colour(settings, recording.signals.skin is not None)
            ),
        )
    except InputError:
        return None


def _reason_not_on_arm(recording: Recording, track: Series, width: float) -> str:
    """Why a track is not on the arm; "" when it may be."""
    q = joint_motion.moving_postures(recording.signals.joints, track.t)
    frames = np.flatnonzero(np.isfinite(track.values[:, 0]))
    if not q.shape[1]:
        return ""
    if len(frames) < max(1.0, _RARELY * len(track.t)):
        return f"seen in {len(frames)} of {len(track.t)} images"
    some = frames[joint_motion.thin_indices(len(frames), _ENOUGH)]
    if (
        len(some) < _FEWEST
        or joint_motion.explained_share(q[some], track.values[some], width) > _CLEARLY
    ):
        return ""
    return candidates.why_not_arm(q, some, track.values[some], width)
