"""Remarks of the pipeline: faults found, sightings per track, missing ground truth."""

from collections.abc import Sequence

import numpy as np

from ..body_model import BodyModel
from ..fault_kinds import fault_warning
from ..settings import Settings, list_configured_sources
from ..sources import describe_source, feature_of
from ..types import Estimate, Fault, Features, Finding, Series
from ..wording import list_in_words


def fault_warnings(faults: Sequence[Fault]) -> tuple[Finding, ...]:
    """A warning for each fault: sensor, kind, since when, size."""
    return tuple(Finding("warning", fault_warning(fault)) for fault in faults)


def sighting_findings(found: Features) -> tuple[Finding, ...]:
    """In how many images each track was seen, and why not in the others, by reason."""
    from ..body.data import trainable

    return tuple(
        Finding("info", f"{name}: {trainable.describe_sighting_counts([found], name)}")
        for name in found.tracks
    )


def unseen_findings(
    found: Estimate, features: Features, body: BodyModel, settings: Settings
) -> tuple[Finding, ...]:
    """What the body looks for and no image shows; "lost" where nothing else of the body is seen."""
    looked = {
        name: health.seen
        for name, health in found.used.items()
        if name in body.senses and name != "encoders"
    }
    seen = {
        name
        for name in looked
        if name in features.tracks and np.isfinite(features.tracks[name].values).any()
    }
    sources = list_configured_sources(settings)
    unseen = dict[str, int]()
    for name in looked.keys() - seen:
        if looked[name]:
            unseen[feature_of(name)] = max(unseen.get(feature_of(name), 0), looked[name])
    unseen = {name: count for name, count in unseen.items() if name not in map(feature_of, seen)}
    if not unseen:
        return ()
    count = max(unseen.values())
    things = [
        f"{describe_source(sources[name])} ({name})" if name in sources else name
        for name in sorted(unseen)
    ]
    never = "they were never seen" if things[1:] else "it was never seen"
    text = f"the body looks for {list_in_words(things)}; {never} in {count} images"
    if seen:
        return (Finding("warning", text),)
    return (Finding("lost", f"{text}: the estimate is of the encoders alone"),)


def truth_findings(found: Estimate, truth: Series | None) -> tuple[Finding, ...]:
    """A remark if errors against truth cannot be computed: no truth, or truth of other joints."""
    if truth is None:
        text = (
            "no truth topic, so no error against truth; name one in [topics] truth, or type "
            "--truth FILE"
        )
        return (Finding("warning", text),)
    if set(truth.names) & set(found.joints.names):
        return ()
    names = (
        f"the truth is of {', '.join(truth.names)}, the estimate of {', '.join(found.joints.names)}"
    )
    return (
        Finding("warning", f"{names}, so no error against truth; name another in [topics] truth"),
    )
