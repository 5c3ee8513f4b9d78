"""The paper's experiments, run in every reading and
with our default, judged over seeds, on one page.
"""

from .claims import Claim
from .records import Experiment
from .rubber_hand import Setting
from .run import Reproduction, run_reproduction
from .table import EXPERIMENTS

__all__ = ["EXPERIMENTS", "Claim", "Experiment", "Reproduction", "Setting", "run_reproduction"]
