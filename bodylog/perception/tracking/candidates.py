"""Features that a log offers: tags and colours, each
with the share of its motion that the joints explain.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ...errors import LogError
from ...settings import Colour
from ...sources import ColourSource, Source, TagSource
from ...types import Array, Recording
from ..colours import blob_measurement, clutter, colour_proposals
from ..colours.coarse_search import CANDIDATES, convert_to_gray
from ..colours.hsv_ranges import HsvRange, covered_hue_names, resolve_colour
from ..tags import unknown
from ..tags.board_shape import BoardShape, recognise_board
from . import joint_motion, target_selection

_FEW = 12
"""Images searched for tags of unknown dictionaries."""
_SHOWN = 6
_FEWEST = 20
TAG = "tag"
COLOUR = "colour"


@dataclass(frozen=True, eq=False)
class Candidate:
    """One thing to track: the source of its track, and why it is not on the arm ("": it is).

    seen: share (0..1) of the images looked at · strays px · explained: share (0..1) of its held-out
    motion that the joints explain, None where it is not computed: too few images, or no joint or
    the thing does not move · track (n,2) px in those images, NaN where not seen.
    """

    name: str
    kind: str
    source: Source
    seen: float
    strays: float
    explained: float | None
    why: str
    track: Array


@dataclass(frozen=True, eq=False)
class FeatureSurvey:
    """Candidates, likeliest on the arm first · images {number:
    (H,W,3) BGR} for a contact sheet · number of images.

    boards: those whose markers are among the candidates.
    """

    candidates: tuple[Candidate, ...]
    images: Mapping[int, Array]
    count: int
    boards: tuple["Board", ...] = ()

    @property
    def arm(self) -> Candidate | None:
        """The first candidate that moves with the joints, or None."""
        return next((one for one in self.candidates if not one.why), None)


@dataclass(frozen=True)
class Board:
    """A ChArUco board: its shape, its dictionary, and the numbers of its markers that were seen."""

    shape: BoardShape
    dictionary: str
    numbers: frozenset[int]

    def holds(self, source: Source) -> bool:
        """Whether a source is one of its markers."""
        return (
            isinstance(source, TagSource)
            and source.dictionary == self.dictionary
            and source.tag in self.numbers
        )


def _recognise_boards(images: list[Array], tags: list[TagSource]) -> Iterator[Board]:
    """Yield the board of each dictionary whose tags lie on one."""
    dictionaries = sorted({tag.dictionary for tag in tags})
    seen = (
        [unknown.tags_by_dictionary(convert_to_gray(image), dictionaries) for image in images]
        if dictionaries
        else []
    )
    for name in dictionaries:
        numbers = [tag.tag for tag in tags if tag.dictionary == name]
        known = [
            one[name].chosen(np.flatnonzero(np.isin(one[name].number, numbers))) for one in seen
        ]
        shape = recognise_board(known)
        if shape is not None:
            yield Board(shape, name, frozenset(numbers))


def survey_features(
    recording: Recording, hand: Colour | None, effector_uv: tuple[float, float] | None = None
) -> FeatureSurvey:
    """Search some images of a recording for candidates; LogError where there are none.

    `effector_uv` (px) is the effector's place in the first image: candidates there come first.
    Whatever has the `hand`'s colour is not on the arm; None without a hand.
    """
    picked = colour_proposals.pick_images(recording)
    t = np.array([moment for moment, _ in picked()])
    if not t.size:
        raise LogError(f"{colour_proposals.why_none(recording)}; type: bodylog info LOG")
    ranges = [
        colour_proposals.range_around_hue(hue)
        for hue in colour_proposals.find_hue_peaks(image for _, image in picked())
    ]
    some = [
        image
        for index, (_, image) in enumerate(picked())
        if index % max(1, -(-len(t) // _FEW)) == 0
    ]
    tags = [one.source for one in unknown.find_unknown_tags(some)]
    shown = set(joint_motion.thin_indices(len(t), _SHOWN).tolist())
    found = list[Array]()
    seen = list[Array]()
    images = dict[int, Array]()
    width = 0
    for index, (_, image) in enumerate(picked()):
        found.append(blob_measurement.measured_blobs([image], ranges)[0])
        seen.append(_centres_of_tags(image, tags))
        width = max(width, image.shape[1])
        if index in shown:
            images[index] = np.array(image)
    q = joint_motion.moving_postures(recording.signals.joints, t)
    judged = [
        *(_tag_candidate(tag, np.stack(seen)[:, k], q, width) for k, tag in enumerate(tags)),
        *(
            _colour_candidate(one, np.stack(found)[:, k], t, recording, width, hand)
            for k, one in enumerate(ranges)
        ),
    ]
    ranked = tuple(sorted(judged, key=lambda one: _candidate_rank(one, effector_uv)))
    return FeatureSurvey(ranked, images, len(t), tuple(_recognise_boards(some, tags)))


def _centres_of_tags(image: Array, tags: list[TagSource]) -> Array:
    """Each tag's centre in an image: (K,2) px, NaN where not seen."""
    where = np.full((len(tags), 2), np.nan)
    for one in (
        unknown.find_unknown_tags([image], sorted({tag.dictionary for tag in tags})) if tags else ()
    ):
        if one.source in tags:
            where[tags.index(one.source)] = one.uv[0]
    return where


def _tag_candidate(source: TagSource, track: Array, q: Array, width: float) -> Candidate:
    return _make_candidate(f"tag {source.tag} ({source.dictionary})", TAG, source, track, q, width)


def _colour_candidate(
    one: HsvRange, found: Array, t: Array, recording: Recording, width: float, hand: Colour | None
) -> Candidate:
    low = one.parts[0][0]
    high = one.parts[-1][1]
    choice = (
        clutter.choose_arm_blobs(t, found, recording.signals.joints, width)
        if np.isfinite(found[:, 1:, 0]).any()
        else None
    )
    if choice is None:
        track = target_selection.select_target(t, found[:, :CANDIDATES], width)[0][:, :2]
    else:
        track = np.where(
            choice.number[:, None] >= 0, found[np.arange(len(t)), choice.number, :2], np.nan
        )
    q = joint_motion.moving_postures(
        recording.signals.joints, t, 0.0 if choice is None else choice.delay
    )
    source = ColourSource({"low": low, "high": high})
    of_hand = () if hand is None else covered_hue_names(resolve_colour(hand, "hand"))
    why = "the hand's colour" if colour_proposals.name_of_middle_hue(one) in of_hand else ""
    if choice is None and not why and np.isfinite(found[:, 1, 0]).mean() > 0.5:
        why = "several things of this colour are in view, and none moves as the joints do"
    return _make_candidate(
        colour_proposals.name_of_middle_hue(one), COLOUR, source, track, q, width, why
    )


def _make_candidate(
    name: str, kind: str, source: Source, track: Array, q: Array, width: float, why: str = ""
) -> Candidate:
    there = np.flatnonzero(np.isfinite(track[:, 0]))
    strays = float(np.hypot(*track[there].std(axis=0))) if there.size else 0.0
    few = (
        f"seen in {there.size} of {len(track)} images, {_FEWEST} are needed"
        if there.size < _FEWEST
        else ""
    )
    reason = why or few or why_not_arm(q, there, track[there], width)
    moves_in_image = not few and q.shape[1] and not joint_motion.stands_still(track[there], width)
    share = joint_motion.explained_share(q[there], track[there], width) if moves_in_image else None
    return Candidate(name, kind, source, there.size / len(track), strays, share, reason, track)


def why_not_arm(q: Array, frames: Array, place: Array, width: float) -> str:
    """Why a thing at places (n,2) px in some images (n,)
    is not on the arm, by angles q (N,M); "": it is.
    """
    if not q.shape[1]:
        return "no joint moves"
    if joint_motion.stands_still(place, width):
        return "it stands still while the joints move"
    if joint_motion.beyond_chance(q, frames, place, width) >= clutter.EXPLAINED:
        return ""
    share = joint_motion.explained_share(q[frames], place, width)
    return f"it does not move as the joints do: they explain {share:.0%}"


def _candidate_rank(
    one: Candidate, effector_uv: tuple[float, float] | None
) -> tuple[float, bool, bool, float, float]:
    """Sort key, smallest first: distance from the given
    effector, then on the arm, tags, explained share.
    """
    seen = one.track[np.isfinite(one.track[:, 0])]
    away = 0.0
    if effector_uv is not None:
        away = float(np.hypot(*(seen[0] - effector_uv))) if len(seen) else np.inf
    return away, bool(one.why), one.kind != TAG, -(one.explained or 0.0) * one.seen, -one.strays
