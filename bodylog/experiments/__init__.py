"""The paper's experiments: recorded, run as printed and by our default, judged over seeds, and put on one page."""

from .records import Claim, Experiment
from .run import Reproduction, reproduce
from .table import EXPERIMENTS

__all__ = ["EXPERIMENTS", "Claim", "Experiment", "Reproduction", "reproduce"]
