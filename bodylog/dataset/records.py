"""What an episode's checks measure: figures with their doubt, and sentences for people."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Measurement:
    """One figure of an episode, of a camera or joint (`part`, "" of the whole), with its standard error.

    text: what is wrong by the episode's own evidence, "" if nothing is · severity: lost, warning or info.
    """

    part: str
    value: float
    std: float | None = None
    text: str = ""
    severity: str = "warning"
