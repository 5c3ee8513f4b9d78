"""What an episode's checks measure: figures with their doubt, and sentences for people."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Measurement:
    """One figure of an episode, of a camera or joint (`part`, "" of the whole), with its standard
    error.

    shared_std: the part of the standard error that siblings have alike, so that no mean over them
    reduces it. text: what is wrong by the episode's own evidence, "" if nothing is · severity:
    lost, warning or info · at: the joint reading that the figure is about, NaN without one.
    """

    part: str
    value: float
    std: float | None = None
    text: str = ""
    severity: str = "warning"
    shared_std: float = 0.0
    at: float = float("nan")
