"""Limits on what a log may decompress to."""

from dataclasses import dataclass

from ..io.toml_keys import key


@dataclass(frozen=True)
class Input:
    """[input]: how damaged and large logs are read."""

    strict: bool = key(False, "Refuse a damaged log instead of reading its sound part.")
    max_image_mpx: float = key(32.0, "Largest image that is decoded.", unit="Mpx", low=1e-3, high=1e4)
    max_message_mb: float = key(
        128.0, "Largest decompressed message or chunk, or 16 times its packed size.", unit="MB", low=1, high=1e5
    )
    max_unpacked_gb: float = key(
        0.5, "Most that a log decompresses to, or 1024 times its packed size.", unit="GB", low=1e-3, high=1e6
    )


LIMITS = Input()
"""The limits where there are no settings."""
