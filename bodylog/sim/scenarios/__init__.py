"""The table of scenarios: one file and one line each."""

from ..plan import Scenario
from . import (
    babble,
    biased_start,
    drift,
    frozen,
    horizontal,
    reach,
    rubber_hand,
    square_encoders,
    touch,
    wrong_start,
)

SCENARIOS: dict[str, Scenario] = {
    "babble": babble.SCENARIO,
    "horizontal": horizontal.SCENARIO,
    "reach": reach.SCENARIO,
    "square-encoders": square_encoders.SCENARIO,
    "drift": drift.SCENARIO,
    "frozen": frozen.SCENARIO,
    "biased-start": biased_start.SCENARIO,
    "wrong-start": wrong_start.SCENARIO,
    "touch": touch.SCENARIO,
    "rubber-hand": rubber_hand.SCENARIO,
}
