"""A scenario's request and plan, and shared functions to build a plan."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from ..errors import UsageError
from ..types import Array
from . import motion
from .arms import Arm

TRAVEL = 0.8
"""Seconds the hand takes from outside the picture to the skin, and back."""

BABBLE = 1.0
REACH = 1.5
"""Seconds from one point of an exploration to the next, and one reach takes."""

Encoders = Callable[[Array, Array, Array], Array]
"""(t (N,) s, true q (N,M) rad, noise (N,M) rad) -> what the encoders read (N,M)."""


@dataclass(frozen=True)
class Request:
    """The request: everything a scenario may depend
    on; `rng` is the scenario's own random generator.
    """

    arm: Arm
    duration: float
    full: bool
    variant: str
    place: str
    rng: np.random.Generator


@dataclass(frozen=True)
class Contact:
    """One stroke on the skin: felt from `onset` for `length`
    s, along the skin's axis from `start` to `stop` (m).

    The image shows it `delay` s later.
    """

    onset: float
    length: float
    delay: float
    start: float
    stop: float


@dataclass(frozen=True)
class ScenarioPlan:
    """The plan: motion, encoder model, contacts, times of
    the covered view, displacement of the hand's image.

    `noise` is the encoders' default standard deviation (rad); `covered` is the (start, end) in s
    during which a card hides the end effector and `margin` around its path; `aside` displaces the
    image of the hand; both in image widths.
    """

    motion: motion.Motion
    noise: float
    encoders: Encoders
    contacts: tuple[Contact, ...] = ()
    covered: tuple[float, float] | None = None
    margin: float = 0.06
    aside: float = 0.0


def read_angles_with_noise(t: Array, q: Array, noise: Array) -> Array:
    """Encoders that read the joint angle plus noise."""
    return q + noise


def plan_exploration(request: Request, swing: Array) -> motion.Motion:
    """Motor babbling: a spline through evenly spread points of the box home ± swing (M,)."""
    return motion.wander_through_points(_points_in_box(request, swing, BABBLE), BABBLE)


def plan_reaches(request: Request, swing: Array) -> motion.Motion:
    """Smooth reaches between places in the middle 70 % of
    the box home ± swing (M,), which exploration covers.
    """
    return motion.reach_between_points(_points_in_box(request, 0.7 * swing, REACH), REACH)


def _points_in_box(request: Request, swing: Array, pace: float) -> Array:
    """Points (K,M) rad of the box home ± swing (M,), one for every `pace` s."""
    return request.arm.home + motion.spread_points(
        int(np.ceil(request.duration / pace)) + 2, swing, request.rng
    )


def swing_of_joints(request: Request, joints: tuple[int, ...] | None = None) -> Array:
    """The swing (M,) rad of `joints`, or of those that
    move by default; of all if the request is `full`.
    """
    most = np.array(request.arm.swing)
    chosen = range(len(most)) if request.full else joints or request.arm.moving
    return np.where(np.isin(np.arange(len(most)), list(chosen)), most, 0.0)


def plan_strokes(request: Request, first: float, delay: Callable[[], float]) -> tuple[Contact, ...]:
    """Contacts from `first` s to the end, each 0.7 to 1.1
    s long, with the hand outside the image between them.
    """
    contacts: list[Contact] = []
    onset = first
    while True:
        contact = _draw_contact(onset, delay(), request.rng)
        gone = onset + contact.length + contact.delay + TRAVEL
        if gone > request.duration:
            return tuple(contacts)
        contacts.append(contact)
        onset = gone + TRAVEL + request.rng.uniform(0.1, 0.9)


def _draw_contact(onset: float, delay: float, rng: np.random.Generator) -> Contact:
    start = rng.uniform(0.08, 0.09)
    return Contact(onset, rng.uniform(0.7, 1.1), delay, start, start - rng.uniform(0.06, 0.07))


@dataclass(frozen=True)
class Scenario:
    """A scenario: description, plan, default duration (s), variants, places, the default first."""

    summary: str
    plan: Callable[[Request], ScenarioPlan]
    duration: float
    variants: tuple[str, ...] = ("",)
    places: tuple[str, ...] = ("",)


def choose_or_default(
    scenario: str, option: str, value: str | None, possible: tuple[str, ...]
) -> str:
    """`value`, or the first of `possible` when it is None;
    UsageError naming the nearest when it is not possible.
    """
    if value is None or value in possible:
        return possible[0] if value is None else value
    if possible == ("",):
        raise UsageError(
            f"scenario {scenario}: it has no {option}s, {value!r} was given; leave --{option} out"
        )
    raise UsageError(
        f"scenario {scenario}: {describe_unknown_name(option, value, possible)}; type: "
        f"--{option} {possible[0]}"
    )


def describe_unknown_name(what: str, value: str, possible: Iterable[str]) -> str:
    """One line about an unknown name: the possible names, and the nearest if one is near."""
    names = list(possible)
    near = get_close_matches(value, names, 1)
    hint = f"; nearest: {near[0]}" if near else ""
    return f"{what} {value!r} is not known; possible: {', '.join(names)}{hint}"
