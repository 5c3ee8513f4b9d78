"""Choices of `bodylog record`, `convert` and `fix`, for
help and completion without importing what they name.
"""

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
SCENES = ("plain", "bare")
CAMERAS = ("head", "wrist")
PLACES = ("right", "left", "centre")
HARDWARE: Mapping[str, str] = {
    "play": "degrees from one end to the other",
    "sag": "degrees with the arm stretched out",
    "payload": "degrees of sag beyond the exploration's, or degrees@s: from when on",
    "stick": "degrees a joint is driven before it slips",
    "correlated": "rad@s: standard deviation and time constant",
    "counts": "encoder steps in a turn",
    "tails": "degrees of freedom of Student's t",
    "outliers": "share of encoder readings",
    "jitter": "s: standard deviation of encoder stamps",
    "rolling": "s from a picture's first row to its last",
}
"""Errors of real joints and encoders that `record
--hardware` simulates, and what their numbers mean.
"""
FORMATS = ("mcap", "lerobot", "lerobot-2.1")
REPEATS = ("mark", "drop", "keep")
"""What `fix` does with frames that repeat the one before."""
EXCLUDED = ("accused", "unusable")
"""Which episodes `fix` leaves out: all that stand
out, and copies, or those alone that lost something.
"""
VIDEO_CODECS = ("lossless", "h264", "av1")
