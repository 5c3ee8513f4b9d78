"""The share of a log's sightings off that a moved
camera or marker leaves: whether one explains the log.
"""

from ...body_model import BodyModel
from ...runtime.blas_threads import one_thread
from ...types import Features
from .change_problem import FEWEST, pose_problem
from .change_system import outlier_share


@one_thread("scipy.linalg")
def moved_share_off(features: Features, body: BodyModel) -> float:
    """The share of sightings more than 3 standard deviations
    off with the likeliest motion of camera, marker or both.

    1 where no track has kinematics, or too little is seen.
    """
    problem = pose_problem(features, body)
    if problem is None or sum(len(kept) for kept in problem.kept) < FEWEST:
        return 1.0
    things = [part for part in problem.parts if part.kind != "joint"]
    return min(outlier_share(problem, parts) for parts in (things, *([one] for one in things)))
