"""Limits on what a log may ask for: of pixels, unpacked bytes, numbers, names and time."""

import math
from dataclasses import dataclass

from ..errors import LogError
from ..io.toml_keys import declare_key


@dataclass(frozen=True)
class Input:
    """[input]: how damaged and large logs are read."""

    strict: bool = declare_key(False, "Refuse a damaged log instead of reading its sound part.")
    max_image_mpx: float = declare_key(
        32.0, "Largest image that is decoded.", unit="Mpx", low=1e-3, high=1e4
    )
    max_message_mb: float = declare_key(
        128.0,
        "Largest decompressed message or chunk, or 16 times its packed size.",
        unit="MB",
        low=1,
        high=1e5,
    )
    max_unpacked_gb: float = declare_key(
        0.5,
        "Most that a log decompresses to, or 1024 times its packed size.",
        unit="GB",
        low=1e-3,
        high=1e6,
    )
    max_table_mb: float = declare_key(
        64.0, "Most that a table's or dataset's numbers and texts take.", unit="MB", low=1, high=1e6
    )
    max_datasets: int = declare_key(2000, "Most datasets of one HDF5 episode.", low=1, high=10**6)
    max_yaml_mb: float = declare_key(
        1.0, "Longest YAML file, of 100 000 values a MB.", unit="MB", low=1e-3, high=100
    )
    max_joints: int = declare_key(
        1000, "Most joints of a URDF, or that joint states name.", low=1, high=10**5
    )
    max_frames: int = declare_key(
        500_000, "Most images of one camera of a dataset or video.", low=1, high=10**8
    )
    max_wait_s: float = declare_key(
        20.0, "Longest time without an answer from a server.", unit="s", low=0.1, high=3600
    )


LIMITS = Input()
"""The limits where there are no settings."""


class TableSize:
    """What the numbers and texts of one log take, counted before they are read."""

    def __init__(self, limits: Input) -> None:
        """Count from 0 bytes."""
        self._most = limits.max_table_mb * 1e6
        self._taken = 0

    def take(self, size: int, what: str) -> None:
        """Count the `size` bytes of `what`; LogError,
        with the setting to type, where all are too many.
        """
        whole = self._taken + size
        if whole > self._most:
            text = (
                f"{what}: {size / 1e6:.4g} MB of numbers and texts, {whole / 1e6:.4g} MB with "
                "those before"
            )
            asked = f"type in robot.toml: [input] max_table_mb = {math.ceil(whole / 1e6)}"
            raise LogError(
                f"{text}, where {self._most / 1e6:g} MB are allowed; to read them, {asked}"
            )
        self._taken = whole
