"""Names that `bodylog record` takes, for its help and for completion: importing them loads nothing of the simulator."""

from collections.abc import Mapping

VARIANTS: Mapping[str, tuple[str, ...]] = {
    "babble": ("usual", "four"),
    "horizontal": (),
    "reach": ("usual", "four"),
    "square-encoders": ("still", "moving"),
    "drift": (),
    "frozen": ("elbow", "first"),
    "biased-start": ("settling", "constant"),
    "wrong-start": ("one", "all", "elsewhere"),
    "touch": ("synchronous", "late", "jitter", "wide-jitter"),
    "rubber-hand": ("synchronous", "asynchronous"),
}
"""The scenarios and their variants, the default variant first."""
ARMS = ("ur5", "seven")
IMAGES = ("jpeg", "raw")
FEATURES = ("ball", "tag", "none")
CAMERAS = ("head", "wrist")
PLACES = ("right", "left", "centre")
