"""Choices of `bodylog record` and `convert`, for help and completion without importing what they name."""

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
FORMATS = ("mcap", "lerobot", "lerobot-2.1")
VIDEO_CODECS = ("lossless", "h264", "av1")
