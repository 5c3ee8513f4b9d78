"""Open constants of the paper: listed, typed, rejected."""

import pytest

from bodylog.errors import UsageError
from bodylog.experiments import EXPERIMENTS
from bodylog.experiments.readings import (
    CENTRE,
    CONSTANTS,
    TOGETHER,
    design_readings,
    list_sweeps,
    parse_reading,
    reading_key,
    reading_number,
    reading_value,
    restrict_readings,
)


def test_constants_have_a_source_and_alternatives():
    for constant in CONSTANTS.values():
        assert constant.printed and constant.place and constant.why and len(constant.values) >= 2
        assert set(constant.at) <= set(constant.values) and (not constant.sweep or constant.unit)
    concerned = {name for experiment in EXPERIMENTS.values() for name in experiment.concerned}
    assert concerned == set(CONSTANTS), "every constant is tried by some experiment"


@pytest.mark.parametrize("reading", [{}, *TOGETHER, {"speed": "30"}, {"sigma_n": "noise"}])
def test_key_is_read_back(reading):
    assert reading_key(parse_reading(reading_key(reading))) == reading_key(reading)


def test_centre_has_one_key_however_typed():
    assert reading_key(parse_reading("sigma_n=amplitude,speed=15")) == CENTRE == reading_key({})
    assert reading_value({}, "sigma_n") == "amplitude" and reading_number({"noise": "0.1"}, "noise") == 0.1
    assert reading_number({"sigma_v": "widths"}, "sigma_v") is None and reading_number({"sigma_v": "17"}, "sigma_v") == 17.0


@pytest.mark.parametrize(
    ("typed", "given"),
    [
        ("sigma=1", "must be one of sigma_n, sigma_v"),
        ("sigma_n", "type: --reading sigma_n=noise"),
        ("sigma_n=loud", "possible: amplitude, noise, learned, or a number above 0"),
        ("integration=3", "possible: printed, equilibrium, implicit; type"),
        ("speed=-1", "or a number above 0 (period in s)"),
        ("speed=nan", "or a number above 0"),
    ],
)
def test_parsed_names_the_possible_values(typed, given):
    with pytest.raises(UsageError) as found:
        parse_reading(typed)
    assert given in str(found.value)


def test_design_has_centre_single_values_and_joint_readings():
    found = [reading_key(reading) for reading in design_readings(("sigma_n", "sigma_v"))]
    assert found[0] == CENTRE and len(found) == len(set(found))
    assert {"sigma_n=noise", "sigma_v=pixels", "sigma_n=noise,sigma_v=widths"} <= set(found)
    assert not any("integration" in one for one in found)
    assert [reading for _, _, reading in list_sweeps(["mu_x"])] == []
    assert restrict_readings(design_readings(("sigma_n", "noise")), ["noise"]) == ({}, {"noise": "0.005"}, {"noise": "0.1"})
