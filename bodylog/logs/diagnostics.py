"""Problems found while reading one log: each place once, losses in bytes, messages and seconds."""

from pathlib import Path

from ..errors import LogError
from .limits import LIMITS, Input
from .records import Finding

_SHOWN = 8

_Loss = tuple[int, int | None, int | None, float | None, str]
"""Start byte; bytes, messages and seconds lost (None: unknown); reason."""


class Diagnostics:
    """Findings of the log at `path`; with `strict` the first loss raises LogError.

    `limits`: how much compressed data in the log may expand to.
    """

    def __init__(self, path: Path, strict: bool = False, limits: Input = LIMITS) -> None:
        """Start without findings."""
        self.path = path
        self.limits = limits
        self._strict = strict
        self._remarks: dict[str, Finding] = {}
        self._losses: dict[int, tuple[int | None, int | None, float | None, str]] = {}

    def warn(self, text: str) -> None:
        """Record a problem that loses no data."""
        self._remarks.setdefault(text, Finding("warning", f"{self.path}: {text}"))

    def info(self, text: str) -> None:
        """Record something worth knowing."""
        self._remarks.setdefault(text, Finding("info", f"{self.path}: {text}"))

    def add_loss(
        self, start: int, size: int | None, messages: int | None, seconds: float | None, why: str
    ) -> None:
        """Record `size` unusable bytes at byte `start`, with
        messages and seconds if known; LogError when strict.
        """
        if start not in self._losses:
            self._losses[start] = (size, messages, seconds, why)
            if self._strict:
                text = self._losses_text([(start, *self._losses[start])])[0]
                raise LogError(
                    f"{self.path}: {text}; type the command without --strict to use the rest"
                )

    def add_messages(self, start: int, messages: int) -> None:
        """Add to the number of messages lost at byte `start`."""
        size, before, seconds, why = self._losses[start]
        self._losses[start] = (size, (before or 0) + messages, seconds, why)

    def set_duration(self, start: int, seconds: float) -> None:
        """Set the duration of the loss at byte `start` to at most `seconds`, if it is unknown."""
        size, messages, before, why = self._losses[start]
        self._losses[start] = (size, messages, seconds if before is None else before, why)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Warnings and infos in order, then losses in file order; beyond eight, their sum."""
        losses = [(start, *loss) for start, loss in sorted(self._losses.items())]
        texts = self._losses_text(losses if len(losses) <= _SHOWN else losses[: _SHOWN - 1])
        if len(losses) > _SHOWN:
            rest = losses[_SHOWN - 1 :]
            texts.append(f"{len(rest)} more places are lost: {_describe_loss_amount(rest)}")
        return (
            *self._remarks.values(),
            *(Finding("lost", f"{self.path}: {text}") for text in texts),
        )

    @staticmethod
    def _losses_text(losses: list[_Loss]) -> list[str]:
        return [
            f"from byte {max(0, loss[0])} {_describe_loss_amount([loss])} lost: {loss[4]}"
            for loss in losses
        ]


def _describe_loss_amount(losses: list[_Loss]) -> str:
    messages = [loss[2] for loss in losses if loss[2] is not None]
    seconds = [loss[3] for loss in losses if loss[3] is not None]
    count = (
        f"{sum(messages)} messages"
        if len(messages) == len(losses)
        else "an unknown number of messages"
    )
    if messages and len(messages) < len(losses):
        count = f"at least {sum(messages)} messages"
    lasting = f"{sum(seconds):.3f} s" if seconds else "an unknown time"
    sizes = [loss[1] for loss in losses if loss[1] is not None]
    bulk = f"{sum(sizes)} bytes" if sizes else "an unknown number of bytes"
    return f"{bulk}, {count}, {lasting}"
