from itertools import pairwise

import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.sim import plan
from bodylog.sim.arms import ARMS


def request(duration=30.0, full=False, seed=0):
    return plan.Request(ARMS["ur5"], duration, full, "", "", np.random.default_rng(seed))


def test_only_the_moving_joints_swing_unless_full():
    np.testing.assert_array_equal(plan.swing_of_joints(request()) > 0, [1, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(plan.swing_of_joints(request(), (0, 3)) > 0, [1, 0, 0, 1, 0, 0])
    np.testing.assert_array_equal(plan.swing_of_joints(request(full=True)), ARMS["ur5"].swing)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("most", [0.0, 0.6, 1.0])
def test_strokes_never_overlap_in_skin_or_picture(seed, most):
    asked = request(seed=seed)
    contacts = plan.plan_strokes(asked, 2.0, lambda: asked.rng.uniform(0, most))
    assert 5 <= len(contacts) <= 14 and contacts[0].onset == 2.0
    for before, after in pairwise(contacts):
        for late in (0.0, 1.0):
            gone = before.onset + before.length + late * before.delay + plan.TRAVEL
            assert after.onset + late * after.delay - plan.TRAVEL > gone
    assert contacts[-1].onset + contacts[-1].length + contacts[-1].delay < 30.0
    assert all(0 < contact.stop < contact.start < 0.13 for contact in contacts)


def test_exploration_covers_what_reaching_uses():
    asked, t = request(60.0), np.linspace(0, 60, 3000)
    swing = plan.swing_of_joints(asked)
    wide, narrow = plan.plan_exploration(asked, swing).position(t), plan.plan_reaches(asked, swing).position(t)
    assert np.all(wide.min(0) <= narrow.min(0)) and np.all(wide.max(0) >= narrow.max(0))


def test_choices():
    assert plan.choose_or_default("touch", "variant", None, ("a", "b")) == "a"
    assert plan.choose_or_default("touch", "variant", "b", ("a", "b")) == "b"
    with pytest.raises(UsageError, match="leave --place out"):
        plan.choose_or_default("touch", "place", "left", ("",))
