"""Constants that the paper prints without a unit
or leaves out: their possible readings, and sweeps.

A reading names a value of one or more constants, as "sigma_n=noise" or
"sigma_v=pixels,integration=implicit"; the others stay at the centre. A constant with an axis also
takes a number: "speed=30".
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from ..errors import UsageError

CENTRE = "centre"
"""The name of the reading in which every constant is at its centre."""

Reading = Mapping[str, str]
"""{constant: value's name or number as text}; all other constants are at the centre."""


@dataclass(frozen=True)
class Constant:
    """One open constant.

    printed: the paper's words · place: their place in it · values {name: meaning}, the centre first
    · unit and sweep: of the axis of possible numbers, empty without one · at {name: number}: place
    on the axis of named values that do not depend on the log · why: the reason for the centre.
    """

    symbol: str
    printed: str
    place: str
    values: Mapping[str, str]
    why: str
    unit: str = ""
    sweep: tuple[float, ...] = ()
    at: Mapping[str, float] = field(default_factory=dict)

    @property
    def centre(self) -> str:
        """The name of its central value."""
        return next(iter(self.values))


CONSTANTS: dict[str, Constant] = {
    "sigma_n": Constant(
        "σ_n",
        "signal variance σ_n = exp(0.02); l = exp(0.1)",
        "Results, first paragraph; Eq. covariance",
        {
            "amplitude": "the kernel's amplitude on standardised outputs, "
            "noise of 1 % of their scatter",
            "noise": "noise of exp(0.02) px beside a kernel of amplitude 1 px²",
            "learned": "not the paper's: l, amplitude and noise of "
            "greatest evidence on the same 46 "
            "samples",
        },
        "the paper's own words are 'signal variance', which is an amplitude",
        "noise over the kernel's amplitude, as deviations",
        (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
        {"amplitude": 0.01, "noise": 1.02},
    ),
    "sigma_v": Constant(
        "σ_v",
        "σ_v ∈ 𝒵² = [5, 5]: integers, a hint at pixels",
        "Results, first paragraph",
        {
            "standardised": "squared scatters of the learned outputs",
            "pixels": "px²",
            "half-widths": "squared half widths of the image, pixels in (−1, 1)",
            "widths": "squared widths of the image, pixels in (0, 1)",
        },
        "the unit in which the kernel's amplitude is near 1",
        "unit in px",
        (1.0, 3.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0),
        {"pixels": 1.0},
    ),
    "mu_x": Constant(
        "μ_x(0)",
        "μ_x ∈ R^M, body configuration prior",
        "Algorithm 1",
        {
            "belief": "the belief the run starts from",
            "home": "the mean of the explored angles",
            "zero": "zero",
        },
        "experiment 2 starts belief and prior at one configuration",
    ),
    "integration": Constant(
        "ė",
        "X = X + Δt Ẋ, 1st order Euler",
        "Algorithm 1; Eq. bodyestimation against Eqs. of e_x, e_p, e_v",
        {
            "printed": "the prediction errors are integrated beside the belief",
            "equilibrium": "the prediction errors are what they tend to, (s − g)/σ",
            "implicit": "the same, with a linearly implicit step, stable at any Δt",
        },
        "as Algorithm 1 is printed",
    ),
    "lambda": Constant(
        "λ",
        "μ̇_x = μ_x + λ e_x; learning rate λ = 1",
        "Algorithm 1; Eq. bodyestimation; Results, first paragraph",
        {
            "second": "μ̇ = λ e_x, integrated with Δt as all else: λ per second",
            "step": "μ ← μ + λ e_x at every step of 0.05 s: λ per step",
        },
        "the equation is a rate, and Algorithm 1 multiplies every rate by Δt",
        "per s",
        (0.1, 1.0, 5.0, 20.0),
        {"second": 1.0, "step": 20.0},
    ),
    "speed": Constant(
        "T",
        "random trajectories that resemble horizontal displacements",
        "Experimental setup, Learning g(x)",
        {"15": "the arm's period is 15 s", "4": "4 s", "60": "60 s"},
        "the middle of 4 and 60 s on a logarithmic axis",
        "period in s",
        (4.0, 6.0, 10.0, 15.0, 25.0, 40.0, 60.0),
        {"15": 15.0, "4": 4.0, "60": 60.0},
    ),
    "noise": Constant(
        "z_p",
        "joint angles with Gaussian added noise",
        "Experimental setup, first paragraph",
        {"0.02": "0.02 rad", "0.005": "0.005 rad", "0.1": "0.1 rad"},
        "that of the simulated logs",
        "rad",
        (0.002, 0.005, 0.02, 0.05, 0.1, 0.3),
        {"0.02": 0.02, "0.005": 0.005, "0.1": 0.1},
    ),
    "b_1": Constant(
        "b_1",
        "b_1 = 1",
        "Extracting visuo-tactile data; Eq. touch",
        {
            "standardised": "per squared scatter of the learned outputs, the unit of σ_v's centre",
            "pixels": "1/px²",
            "cm": "1/cm² at the effector's distance",
            "widths": "per squared width of the image",
        },
        "s_v − s_o in the unit of σ_v",
        "unit in px",
        (1.0, 3.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0),
        {"pixels": 1.0},
    ),
    "o_v": Constant(
        "o_v",
        "it knows the relation between the touch signal and the location on the body",
        "Adding tactile feedback",
        {
            "touched": "the touched cell's place beside the effector is known: the hand at the "
            "effector, ± 0.3 px",
            "stroke": "the hand as it strokes along the limb, less the "
            "mean place of all touched cells",
            "hand": "the hand as it is seen, some cm beside the effector",
        },
        "the paper's own words: the robot knows which cell is touched, and where it is on the limb",
    ),
    "s_t": Constant(
        "s_t",
        "s_t, tactile sensor value",
        "Eq. xwithtouch",
        {
            "best": "what g_t is where the hand is at the effector, a_1 a_2 f_t",
            "peak": "a_1 a_2 at every touch, in time or not",
            "touched": "1 at every touch",
        },
        "a touch in time with its stroke then has no error where the hand is at the effector",
    ),
    "sigma_t": Constant(
        "σ_t",
        "σ_t, never printed",
        "Eq. xwithtouch",
        {
            "scale": "(a_1 a_2)², the square of g_t's greatest value",
            "hundredth": "a hundredth of it",
            "1": "1, as σ_x and σ_p, whatever a_2 is",
        },
        "makes e_t ∂g_t of the order of the other senses' terms",
        "σ_t over (a_1 a_2)²",
        (0.01, 0.1, 1.0, 10.0, 100.0, 1e4, 1e6),
        {"scale": 1.0, "hundredth": 0.01},
    ),
    "a_2": Constant(
        "a_2",
        "a_2, tuned in concordance with human data",
        "Eq. touch",
        {"1000": "1/a_1, so that g_t is 1 at its peak", "1": "1, so that f_t is"},
        "a likelihood that a touch reading between 0 and 1 is compared with",
        "1",
        (1.0, 10.0, 100.0, 1000.0),
        {"1": 1.0, "1000": 1000.0},
    ),
    "b_2": Constant(
        "b_2",
        "b_2, tuned in concordance with human data",
        "Eq. touch",
        {"0.12": "f_t halves at 0.12 s", "0.06": "at 0.06 s", "0.3": "at 0.3 s"},
        "what perception uses",
        "s at which f_t halves",
        (0.03, 0.06, 0.12, 0.2, 0.3, 0.5, 1.0),
        {"0.12": 0.12, "0.06": 0.06, "0.3": 0.3},
    ),
}

TOGETHER: tuple[Reading, ...] = (
    {"sigma_v": "pixels", "integration": "implicit"},
    {"sigma_n": "noise", "sigma_v": "widths"},
    {"sigma_n": "noise", "sigma_v": "widths", "speed": "4"},
    {"sigma_n": "learned", "integration": "equilibrium"},
    {"noise": "0.1", "speed": "60"},
    {"a_2": "1", "integration": "equilibrium"},
    {"a_2": "1", "sigma_t": "1"},
    {"b_1": "pixels", "a_2": "1", "sigma_t": "1"},
    {"b_1": "pixels", "a_2": "1", "sigma_t": "1", "sigma_n": "noise", "sigma_v": "widths"},
    {"s_t": "peak", "b_2": "0.3"},
)
"""Readings of several constants at once: those in
which one constant cancels the effect of another.
"""


def reading_key(reading: Reading) -> str:
    """The reading as text, constants in the table's order; CENTRE where all are at the centre."""
    parts = [
        f"{name}={reading[name]}"
        for name in CONSTANTS
        if reading.get(name, CONSTANTS[name].centre) != _central_value(name)
    ]
    return ",".join(parts) or CENTRE


def parse_reading(text: str) -> Reading:
    """The reading that `reading_key` wrote or a user typed; UsageError names possible values."""
    if text == CENTRE:
        return {}
    found: dict[str, str] = {}
    for part in text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if name not in CONSTANTS or not equals:
            possible = ", ".join(CONSTANTS)
            raise UsageError(
                f"--reading {part!r}: the constant must be one of {possible}; type: "
                "--reading sigma_n=noise"
            )
        found[name] = _parse_reading_value(name, value)
    return found


def _parse_reading_value(name: str, value: str) -> str:
    constant = CONSTANTS[name]
    if value in constant.values:
        return value
    number = _parse_bounded_number(value)
    if constant.sweep and number is not None and number > 0.0:
        return f"{number:g}"
    axis = f", or a number above 0 ({constant.unit})" if constant.sweep else ""
    possible = ", ".join(constant.values) + axis
    raise UsageError(
        f"--reading {name}={value}: possible: {possible}; type: --reading {name}={constant.centre}"
    )


def _parse_bounded_number(text: str) -> float | None:
    try:
        found = float(text)
    except ValueError:
        return None
    return found if abs(found) < 1e30 else None


def reading_value(reading: Reading, name: str) -> str:
    """A constant's value in a reading: a value's name, or a number as text."""
    return reading.get(name, _central_value(name))


def reading_number(reading: Reading, name: str) -> float | None:
    """The reading's number on the constant's axis; None for a value that depends on the log."""
    text = reading_value(reading, name)
    return CONSTANTS[name].at.get(text) if text in CONSTANTS[name].values else float(text)


def restrict_readings(tried: Iterable[Reading], names: Iterable[str]) -> tuple[Reading, ...]:
    """The readings of these constants alone; all if
    there are none, as for a single requested reading.
    """
    held = set(names)
    found = list(tried)
    return tuple(reading for reading in found if set(reading) <= held) or tuple(found)


def design_readings(concerned: Iterable[str]) -> tuple[Reading, ...]:
    """The readings for a claim about these constants:
    the centre, one constant at a time, and TOGETHER.
    """
    names = [name for name in CONSTANTS if name in set(concerned)]
    alone: list[Reading] = [{name: v} for name in names for v in list(CONSTANTS[name].values)[1:]]
    together = [reading for reading in TOGETHER if set(reading) <= set(names)]
    return ({}, *alone, *together)


def list_sweeps(concerned: Iterable[str]) -> tuple[tuple[str, float, Reading], ...]:
    """The readings that sweep one constant each, the
    others at the centre: constant, number, reading.
    """
    return tuple((name, v, {name: f"{v:g}"}) for name in concerned for v in CONSTANTS[name].sweep)


def _central_value(name: str) -> str:
    return CONSTANTS[name].centre
