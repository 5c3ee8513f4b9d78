"""The metadata of an annotated log about its estimate."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..errors import LogError
from ..io.values import read_json
from ..logs.mcap.prefix import NAME
from ..types import Capabilities, Estimate, Finding, Health


def describe_estimate(estimate: Estimate) -> dict[str, str]:
    """The parts of an estimate without a topic, as entries
    of the metadata record; `read_estimate` reads them.
    """
    used = {sense: asdict(health) for sense, health in estimate.used.items()}
    findings = [asdict(finding) for finding in estimate.findings]
    return {
        "method": estimate.method,
        "used": json.dumps(used, sort_keys=True, default=dict),
        "findings": json.dumps(findings, sort_keys=True),
        "resolved": json.dumps(dict(estimate.settings), sort_keys=True, default=float),
        "can": json.dumps(asdict(estimate.can), sort_keys=True),
    }


@dataclass(frozen=True)
class DeclaredEstimate:
    """The parts of an estimate in the metadata record."""

    method: str
    used: Mapping[str, Health]
    settings: Mapping[str, Any]
    findings: tuple[Finding, ...]
    can: Capabilities


def _check_health(found: Health) -> Health:
    """Validate health counts: ValueError for impossible ones, TypeError for no numbers."""
    counts = (found.seen, found.used, *found.rejected.values())
    if (
        not all(isinstance(count, int) and 0 <= count < 1 << 63 for count in counts)
        or not found.largest_gap_s >= 0.0
    ):
        raise ValueError("how much was used is not a number of messages")
    return found


def _check_finding(found: Finding) -> Finding:
    """Validate a finding; ValueError if its text is not a string."""
    if not isinstance(found.severity, str) or not isinstance(found.text, str):
        raise ValueError("a finding that is not text")
    return found


def _check_capabilities(found: Mapping[str, Any]) -> Capabilities:
    if not all(isinstance(value, bool) for value in found.values()):
        raise ValueError(f"can: {found!r}, where each capability is true or false")
    return Capabilities(**found)


def read_declared_estimate(path: Path, metadata: Mapping[str, str]) -> DeclaredEstimate:
    """Read back the entries of `describe_estimate`; LogError if they are damaged."""
    try:
        return DeclaredEstimate(
            metadata.get("method", ""),
            {
                sense: _check_health(Health(**health))
                for sense, health in read_json(metadata.get("used", "{}")).items()
            },
            dict(read_json(metadata.get("resolved", "{}"))),
            tuple(
                _check_finding(Finding(**finding))
                for finding in read_json(metadata.get("findings", "[]"))
            ),
            _check_capabilities(read_json(metadata.get("can", "{}"))),
        )
    except (ValueError, TypeError, AttributeError) as problem:
        raise LogError(
            f"{path}: the metadata record {NAME} is damaged ({problem}); {type_again(path)}"
        ) from None


def type_again(path: Path) -> str:
    """The command that writes a new estimate into a log."""
    return f"type: bodylog estimate {path} --body body.npz -o OUT.mcap"
