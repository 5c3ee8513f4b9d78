"""How much a log may unpack to."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Input:
    """[input]: whether a damaged log is refused instead of read as far as it is sound; how much it may unpack to.

    Of what is larger than `max_image_mpx` (10⁶ pixels) no image is made, and of what is larger than `max_message_mb`
    (10⁶ bytes) no packed message or chunk. `max_unpacked_gb` (10⁹ bytes) limits all of a file, unless that is at most
    a thousand times as large as what is packed.
    """

    strict: bool = False
    max_image_mpx: float = 32.0
    max_message_mb: float = 128.0
    max_unpacked_gb: float = 0.5


LIMITS = Input()
"""The limits where no settings are at hand."""
