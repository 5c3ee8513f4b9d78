"""A dataset judged: episodes that stand out from their siblings, and a verdict in a few
sentences."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..delays.flow_delay import METHOD_STD_S, list_tried_delays
from ..types import Array, Fault, Score
from ..wording import list_in_words, quantity_text
from .checks import BY_NAME, Check
from .siblings import (
    LEAST_EPISODES,
    Outlier,
    PooledFigure,
    find_other_delays,
    find_outliers,
    own_std,
    pool_values,
)
from .views import Views, compare_views, find_moved, moved_sentences

Row = dict[str, Any]
Evidence = Mapping[str, Any]
Table = Mapping[str, tuple[Array, Array, float]]
"""An episode's evidence (see examination.evidence), and values, standard errors and resolution of
figures."""
UNIT_RATIO = 3.0
"""Factor between the sizes of an episode's joints and its siblings' from which their unit is
another."""
UNIT_AGREEMENT = 0.35
"""Largest difference of that factor's logarithm between joints."""
DEGREES_PER_RAD = 57.29578
SWAP_SHARE = 0.5
"""Distance of a swapped joint from the other's siblings, over its distance from its own."""
SIGNIFICANT_SIGMA = 2.0
OTHER_MOTION = 2.0
"""Factor between a picture's motion with the joints and its siblings' from which something else
moves in it: cameras of nine drawn worlds are within 1.7, and somebody who walks through the picture
of one episode makes it 5 and more in six of them."""
STOP_SHARE = 0.02
"""Distance from an end of what a joint reads in all episodes, over its range, within which it is at
a stop."""
_UNMEASURED = (float("nan"), None, 0.0, None)
MOST_DECLARATIONS = 10
"""Most sentences of the verdict on what a dataset's lists say otherwise than its files."""
_OF_LISTS = ("info.json", "meta/", "the dataset lists", "the video")
"""What their texts name."""
REPORTED_SHARE = 0.05
"""Share of a camera's images from which the verdict names what is wrong with them."""


@dataclass(frozen=True)
class StandsOut:
    """An episode that stands out from its siblings: its name, what in, and the sentence about
    it."""

    episode: str
    figures: tuple[str, ...]
    z: float
    text: str
    accused: bool = True


@dataclass(frozen=True)
class PooledDelay:
    """A delay over episodes (s): mean, the standard error that more episodes would reduce, the one
    that they share, and the jitter between episodes that their own errors do not explain; of how
    many episodes it is by the robot's surface (0: by flow)."""

    mean: float
    own_std: float
    shared_std: float
    jitter: float
    by_surface: int = 0

    @property
    def std(self) -> float:
        """Standard error of the mean."""
        return float(np.hypot(self.own_std, self.shared_std))


@dataclass(frozen=True, eq=False)
class DatasetJudgement:
    """rows, each beside its siblings · evidence {row's name: Evidence} · verdict in
    sentences · scores of the whole, their standard errors beside · outliers, the farthest first."""

    rows: list[Row]
    evidence: Mapping[str, Evidence]
    verdict: tuple[str, ...]
    scores: tuple[Score, ...]
    outliers: tuple[StandsOut, ...]
    findings: tuple[str, ...] = ()
    pooled: Mapping[str, PooledDelay] = field(default_factory=dict)


def judge_episodes(
    rows: Sequence[Row],
    evidence: Mapping[str, Evidence],
    findings: Sequence[str] = (),
    since: Sequence[tuple[str, Fault]] = (),
) -> DatasetJudgement:
    """Judge the rows of a dataset's episodes; `findings`: what is wrong with the dataset's own
    files · since: faults by a body that all episodes from one on have, and the name of that one."""
    names = [row["name"] for row in rows if row["name"] in evidence]
    alone = evidence
    evidence = _with_common_row_times(names, evidence)
    kinds = _group_by_robot(names, evidence)
    groups = list(kinds.values())
    views = [compare_views(group, evidence) for group in groups]
    tables = [_comparable_figures(group, evidence) for group in groups]
    looks = sum(
        int(np.isfinite(values).sum()) for table in tables for values, _, _ in table.values()
    )
    looks += sum(int(np.isfinite(one.moves).sum()) for own in views for one in own.values())
    standouts = list[StandsOut]()
    lasting = list[str]()
    for group, table, own in zip(groups, tables, views, strict=True):
        moved = {camera: find_moved(one, looks) for camera, one in own.items()}
        single = {camera: outliers for camera, (outliers, _) in moved.items()}
        standouts += _find_standouts(group, evidence, table, single, looks)
        for camera, (_, step) in moved.items():
            lasting += moved_sentences(camera, step, group)
        singles, more = _compare_with_body(group, evidence, since)
        standouts += singles
        lasting += more
    odd = sorted(standouts, key=lambda one: -one.z)
    outliers = tuple(one for one in odd if one.accused)
    summary_findings = [
        _with_delays(
            _with_outliers(row, [one for one in odd if one.episode == row["name"]]), alone, evidence
        )
        for row in rows
    ]
    doubles = (*_duplicate_sentences(names, evidence), *_same_film_sentences(names, evidence))
    streams = [text for group in groups for text in _stream_sentences(group, evidence)]
    pooled = _pool_delays(names, evidence, odd)
    scores = tuple(_dataset_scores(rows, evidence, outliers, pooled, views))
    whole = (*findings, *_robot_sentences(kinds), *streams, *doubles, *lasting)
    differing = [one for one in odd if not one.accused]
    verdict = tuple(_dataset_verdict(rows, names, evidence, outliers, differing, pooled, whole))
    return DatasetJudgement(summary_findings, evidence, verdict, scores, outliers, whole, pooled)


Robot = tuple[str, tuple[str, ...]]
"""The type of a robot and the names of its joints, sorted."""


def _group_by_robot(
    names: Sequence[str], evidence: Mapping[str, Evidence]
) -> dict[Robot, list[str]]:
    """The episodes of each robot, the one with most episodes first; those whose joints are not
    known are taken for its own."""
    found: dict[Robot, list[str]] = {}
    unknown = list[str]()
    for name in names:
        joints = evidence[name]["joints"]
        if joints is None or not joints["names"]:
            unknown.append(name)
        else:
            robot = (str(evidence[name].get("robot", "")), tuple(sorted(joints["names"])))
            found.setdefault(robot, []).append(name)
    ordered = dict(sorted(found.items(), key=lambda one: -len(one[1]))) or {("", ()): []}
    first = next(iter(ordered))
    chosen = {*ordered[first], *unknown}
    ordered[first] = [name for name in names if name in chosen]
    return ordered


def _robot_sentences(kinds: Mapping[Robot, Sequence[str]]) -> Iterator[str]:
    """That there are several robots, and whose episodes are few."""
    if len(kinds) < 2:
        return
    shown = []
    for number, ((robot, joints), group) in enumerate(kinds.items()):
        about = f"{robot or 'a robot'} with {len(joints)} joints"
        about += f" ({list_in_words(list(joints))})"
        whose = f": {list_in_words(list(group))}" if number else ""
        shown.append(f"{about} in {len(group)} of them{whose}")
    yield (
        f"the episodes are of {len(kinds)} robots, and each is compared with its own: "
        + "; ".join(shown)
    )


def _compare_with_body(
    names: Sequence[str], evidence: Mapping[str, Evidence], together: Sequence[tuple[str, Fault]]
) -> tuple[list[StandsOut], list[str]]:
    """Episodes in which a sensor differs from what a body learned, and sentences on those in which
    it does so in most episodes, or from one on; `together`: what episodes from one on tell."""
    episodes: dict[tuple[str, str], list[str]] = {}
    sizes: dict[tuple[str, str], dict[str, tuple[float, float, str]]] = {}
    for name in names:
        for kind, sensor, size, std, unit in evidence[name].get("faults", ()):
            episodes.setdefault((sensor, kind), []).append(name)
            if size is not None and std is not None:
                sizes.setdefault((sensor, kind), {})[name] = (size, std, unit)
    singles = list[StandsOut]()
    lasting = list[str]()
    for first, fault in together:
        if first not in names:
            continue
        place = names.index(first)
        whose = f"from {first} on" if place else f"in all {len(names)} episodes"
        offset = quantity_text(fault.size, fault.std, fault.unit, True)
        about = f", {offset}" if fault.std is not None else ""
        text = f"{fault.name}: {_OF_BODY.get(fault.kind, fault.kind)} than the body that is given"
        lasting.append(f"{text}{about}, {whose}, by these episodes together")
        before = [one for one in episodes.get((fault.name, fault.kind), ()) if one in names[:place]]
        episodes[fault.name, fault.kind] = before
    for (sensor, kind), odd in episodes.items():
        if not odd:
            continue
        known = sizes.get((sensor, kind), {})
        text = f"{sensor}: {_OF_BODY.get(kind, kind)} than the body that is given"
        count = len(odd)
        since = list(names[-count:]) == odd
        if count > 1 and (since or 2 * count > len(names)):
            where = f"from {odd[0]} on" if since else f"in {count} of {len(names)} episodes"
            values = np.array([size for size, *_ in known.values()])
            about = ""
            if len(values):
                unit = next(iter(known.values()))[2]
                about = f", {quantity_text(float(np.median(values)), None, unit, True)}"
            lasting.append(f"{text}{about}, {where}")
            continue
        for name in odd:
            size, std, unit = known.get(name, (0.0, 0.0, ""))
            about = f", {quantity_text(size, std, unit, True)}" if name in known else ""
            z = abs(size) / std if std else 0.0
            cost = "to a learner, the same readings are another posture"
            singles.append(StandsOut(name, (f"{kind}/{sensor}",), z, f"{text}{about}; {cost}"))
    return singles, lasting


_OF_BODY = {"offset": "its encoder has another zero", "moved": "it stands elsewhere before the arm"}
"""What a fault means between episodes."""


def _with_outliers(row: Row, outliers: Sequence[StandsOut]) -> Row:
    texts = [["warning" if one.accused else "info", one.text] for one in outliers]
    verdict = [one.text for one in outliers if one.accused] or list(row["verdict"])
    return {**row, "findings": [*row["findings"], *texts], "verdict": verdict}


def _find_standouts(
    names: Sequence[str],
    evidence: Mapping[str, Evidence],
    table: Table,
    moved: Mapping[str, Sequence[Outlier]],
    looks: int,
) -> Iterator[StandsOut]:
    """Episodes that stand out, each cause once: a wrong unit or swapped joints explain all else
    about these joints; `moved` {camera: episodes whose view stands out}."""
    found: dict[tuple[int, str], Outlier] = {}
    for figure, (values, std, resolution) in table.items():
        for one in find_outliers(values, std, resolution, looks):
            if not _is_at_stop(figure, names[one.number], names, evidence):
                found[one.number, figure] = one
    for camera, outliers in moved.items():
        found |= {(one.number, f"moved/{camera}"): one for one in outliers}
    doubted = set[tuple[int, str]]()
    for camera in sorted({camera for name in names for camera in evidence[name]["cameras"]}):
        figure = f"delay/{camera}"
        late = find_other_delays(_flow_profiles(camera, names, evidence), list_tried_delays())
        for one in late:
            found.setdefault((one.number, figure), one)
        by_flow = [k for k, name in enumerate(names) if _has_flow_profile(camera, evidence[name])]
        doubted |= {(k, figure) for k in set(by_flow).difference(one.number for one in late)}
    for number in sorted({number for number, _ in found}):
        own = {figure: one for (k, figure), one in found.items() if k == number}
        unsure = {figure for k, figure in doubted if k == number}
        yield from _explain_outliers(names[number], own, table, unsure)


def _has_flow_profile(camera: str, evidence: Evidence) -> bool:
    """Whether an episode's delay of a camera is by flow, with the likelihood of all delays."""
    about = evidence["cameras"].get(camera, {})
    by_surface = f"delay/{camera}" in evidence.get("by_surface", ())
    return bool(about.get("delay_profile")) and not by_surface


def _flow_profiles(camera: str, names: Sequence[str], evidence: Mapping[str, Evidence]) -> Array:
    """The log likelihood (N,K) of a camera's delays by flow in each episode; NaN where it has none,
    where the robot's surface tells the delay, and where the picture moves much more with the joints
    than in most episodes, or much less: something else moves in it, or it stands still."""
    profiles = np.full((len(names), len(list_tried_delays())), np.nan)
    motions = np.full(len(names), np.nan)
    for number, name in enumerate(names):
        if _has_flow_profile(camera, evidence[name]):
            about = evidence[name]["cameras"][camera]
            profiles[number] = about["delay_profile"]
            motions[number] = np.log(max(about["flow_per_motion"], 1e-9))
    if np.isfinite(motions).any():
        other = np.abs(motions - np.nanmedian(motions)) > np.log(OTHER_MOTION)
        profiles[other] = np.nan
    return profiles


def _is_at_stop(
    figure: str, episode: str, names: Sequence[str], evidence: Mapping[str, Evidence]
) -> bool:
    """Whether a figure is about a joint at an end of what it reads in all episodes: it may rest
    there."""
    at = evidence[episode]["figures"][figure][3]
    if at is None:
        return False
    joint = figure.partition("/")[2]
    lows = []
    highs = []
    for name in names:
        joints = evidence[name]["joints"]
        if name != episode and joints is not None and joint in joints["names"]:
            number = joints["names"].index(joint)
            lows.append(joints["low"][number])
            highs.append(joints["high"][number])
    if not lows:
        return False
    margin = STOP_SHARE * (max(highs) - min(lows))
    return not min(lows) + margin < at < max(highs) - margin


def _comparable_figures(
    names: Sequence[str], evidence: Mapping[str, Evidence]
) -> dict[str, tuple[Array, Array, float]]:
    """Values, standard errors (N,) and resolution of each figure by which siblings are compared."""
    figures = sorted({figure for name in names for figure in evidence[name]["figures"]})
    travels = _joint_travels(names, evidence)
    found = {}
    for figure in figures:
        check = check_of(figure)
        if check is None or check.resolution is None:
            continue
        known = [evidence[name]["figures"].get(figure, _UNMEASURED) for name in names]
        values = np.array([value for value, *_ in known])
        resolution = check.resolution
        if check.unit == "joint":
            resolution *= travels.get(figure.partition("/")[2], travels.get("", 0.0))
        found[figure] = (
            values,
            np.array([own_std(std, shared) for _, std, shared, _ in known]),
            max(resolution, 1e-9),
        )
    return found


def check_of(figure: str) -> Check | None:
    """The check of a figure."""
    return BY_NAME.get(figure) or BY_NAME.get(figure.partition("/")[0])


def _joint_travels(names: Sequence[str], evidence: Mapping[str, Evidence]) -> dict[str, float]:
    """What each joint, and the widest of all (""), moves in an episode, at the median over
    episodes."""
    spans: dict[str, list[float]] = {}
    for name in names:
        joints = evidence[name]["joints"]
        if joints is None:
            continue
        own = {
            one: float(np.ptp([value for value in curve if value is not None] or [0.0]))
            for one, curve in zip(joints["names"], joints["curves"], strict=True)
        }
        for joint, span in {**own, "": max(own.values(), default=0.0)}.items():
            spans.setdefault(joint, []).append(span)
    return {joint: float(np.median(some)) for joint, some in spans.items()}


_AGAINST_JOINTS = ("delay", "delay/action", "error/action")
"""Figures that tell nothing where the joints' readings are wrong: they are measured against
these."""
_JOINT_CAUSES = ("clipped", "stuck", "longest_repeat", "jumps", "still")
_JOINT_FIGURES = ("start", "mean", "size", "stuck", "longest_repeat", "clipped", "still", "error")


def _explain_outliers(
    episode: str, own: Mapping[str, Outlier], table: Table, doubted: Collection[str]
) -> Iterator[StandsOut]:
    """The causes that explain what is odd of an episode, the strongest explanations first; `doubted`
    figures accuse no episode: delays that the likelihood of all episodes does not confirm."""
    left = dict(own)
    yield from _find_other_unit(episode, left, table)
    yield from _find_swapped_joints(episode, left, table)
    if len(left) < len(own) or any(_check_name(figure) in _JOINT_CAUSES for figure in left):
        left = {f: one for f, one in left.items() if _check_name(f) not in _AGAINST_JOINTS}
    for part in sorted({figure.partition("/")[2] for figure in left}):
        group = {figure: one for figure, one in left.items() if figure.partition("/")[2] == part}
        accusing = [f for f in group if _figure_accuses(f) and f not in doubted]
        # the figure that says most of the cause comes first in the table of checks
        first = min(accusing or group, key=_check_rank)
        z = max(group[figure].z for figure in accusing or group)
        text = _outlier_text(first, group[first])
        yield StandsOut(episode, tuple(sorted(group)), z, text, bool(accusing))


def _figure_accuses(figure: str) -> bool:
    check = check_of(figure)
    return check is not None and check.accuses


def _check_rank(figure: str) -> int:
    """Place of a figure's check in the table."""
    return list(BY_NAME).index(_check_name(figure))


def _check_name(figure: str) -> str:
    check = check_of(figure)
    return "" if check is None else check.name


def _find_other_unit(episode: str, left: dict[str, Outlier], table: Table) -> Iterator[StandsOut]:
    """All joints larger or smaller by one factor: another unit."""
    sizes = {figure: one for figure, one in left.items() if figure.startswith("size/")}
    every = [figure for figure in table if figure.startswith("size/")]
    if not sizes or len(sizes) < max(2, (2 * len(every)) // 3):
        return
    ratios = np.array([one.value - one.others for one in sizes.values()])
    ratio = float(np.median(ratios))
    if abs(ratio) < np.log(UNIT_RATIO) or np.median(np.abs(ratios - ratio)) > UNIT_AGREEMENT:
        return
    factor = float(np.exp(abs(ratio)))
    way = "larger" if ratio > 0.0 else "smaller"
    text = f"its joints read {factor:.3g} times {way} than the others': another unit"
    if abs(np.log(factor / DEGREES_PER_RAD)) < UNIT_AGREEMENT:
        text += ", degrees among radians" if ratio > 0.0 else ", radians among degrees"
    figures = tuple(figure for figure in left if figure.partition("/")[0] in _JOINT_FIGURES)
    z = max(left[figure].z for figure in figures)
    for figure in figures:
        del left[figure]
    yield StandsOut(episode, figures, z, text)


def _find_swapped_joints(
    episode: str, left: dict[str, Outlier], table: Table
) -> Iterator[StandsOut]:
    """Two joints of which each has the other's usual posture."""
    for name in ("mean", "start"):
        odd = {
            figure.partition("/")[2]: one
            for figure, one in left.items()
            if figure.startswith(f"{name}/")
        }
        for a in sorted(odd):
            for b in sorted(odd):
                if a < b and a in odd and b in odd and _values_are_exchanged(odd[a], odd[b]):
                    figures = tuple(figure for figure in left if figure.partition("/")[2] in (a, b))
                    z = max(left[figure].z for figure in figures)
                    for figure in figures:
                        del left[figure]
                    del odd[a], odd[b]
                    text = f"{a} and {b} are swapped: each reads what the other reads elsewhere"
                    yield StandsOut(episode, figures, z, text)
                    break


def _values_are_exchanged(a: Outlier, b: Outlier) -> bool:
    """Whether each value is near the other's siblings and far from its own."""
    near = max(abs(a.value - b.others), abs(b.value - a.others))
    return near < SWAP_SHARE * min(abs(a.value - a.others), abs(b.value - b.others))


def _outlier_text(figure: str, one: Outlier) -> str:
    check = check_of(figure)
    assert check is not None
    unit = {"s": "s", "1": "", "joint": ""}.get(check.unit, check.unit)
    value = f"{one.value:.3g} {unit}".strip()
    others = f"{one.others:.3g} ± {one.spread:.2g} {unit}".strip()
    return (
        f"{figure} is {value}, of the others {others}: {one.z:.0f} σ, "
        f"{one.bound:.1f} are the bound for all looks together; to a learner, {check.cost}"
    )


def _duplicate_sentences(names: Sequence[str], evidence: Mapping[str, Evidence]) -> Iterator[str]:
    """Episodes whose joints and actions are equal in every number."""
    digests = Counter(evidence[name]["digest"] for name in names if evidence[name]["digest"])
    for digest, count in digests.items():
        if count > 1:
            same = [name for name in names if evidence[name]["digest"] == digest]
            yield f"{' and '.join(same)} are the same episode: equal in every number"


def _stream_sentences(names: Sequence[str], evidence: Mapping[str, Evidence]) -> Iterator[str]:
    """Numbers and cameras that fewer than half of the episodes of a robot lack, and images of
    another size than in most."""
    streams = {
        name: {*evidence[name].get("statistics", ()), *evidence[name]["cameras"]} for name in names
    }
    for stream in sorted(set[str]().union(*streams.values())):
        lacking = [name for name in names if stream not in streams[name]]
        if 0 < 2 * len(lacking) < len(names):
            count = f"{len(lacking)} of {len(names)} episodes"
            yield f"{stream}: missing in {count}: {list_in_words(lacking)}"
    for camera in sorted({camera for name in names for camera in evidence[name]["cameras"]}):
        sizes: dict[str, list[str]] = {}
        for name in names:
            size = evidence[name]["cameras"].get(camera, {}).get("size")
            if size:
                sizes.setdefault(" x ".join(map(str, size)), []).append(name)
        (usual, most), *others = sorted(sizes.items(), key=lambda one: -len(one[1])) or [("", [])]
        for size, odd in others:
            text = f"{camera}: images of {usual} in {len(most)} of {len(names)} episodes"
            yield f"{text}, of {size} in {list_in_words(odd)}"


def _same_film_sentences(names: Sequence[str], evidence: Mapping[str, Evidence]) -> Iterator[str]:
    """Episodes that have the film of another: equal in every picture that changes."""
    films: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        for camera, about in evidence[name]["cameras"].items():
            if len(set(about["thumbnails"])) > 1:
                films.setdefault((camera, *about["thumbnails"]), []).append(name)
    for (camera, *_), same in films.items():
        if len(same) > 1:
            yield f"{camera}: {' and '.join(same)} have the same film: one is of another episode"


def _pool_delays(
    names: Sequence[str], evidence: Mapping[str, Evidence], outliers: Sequence[StandsOut]
) -> dict[str, PooledDelay]:
    """Delays over episodes by figure, without those of episodes that stand out in it."""
    odd = {(one.episode, figure) for one in outliers for figure in one.figures}
    figures = sorted(
        {f for name in names for f in evidence[name]["figures"] if "delay" in f.split("/")[:2]}
    )
    found = {}
    for figure in figures:
        by_surface = {name for name in names if figure in evidence[name].get("by_surface", ())}
        summary_findings = []
        for name in names:
            value, std, shared, _ = evidence[name]["figures"].get(figure, _UNMEASURED)
            if std is None or (name, figure) in odd or (by_surface and name not in by_surface):
                continue
            own = own_std(std, shared)
            by_flow = figure != "delay/action" and not by_surface
            method = METHOD_STD_S if by_flow else 0.0
            summary_findings.append((value, own, float(np.hypot(shared, method))))
        if summary_findings:
            values, stds, shares = np.array(summary_findings).T
            one = pool_values(values, stds)
            shared_std = float(shares.mean())
            found[figure] = PooledDelay(one.mean, one.std, shared_std, one.jitter, len(by_surface))
    return found


def _with_common_row_times(
    names: Sequence[str], evidence: Mapping[str, Evidence]
) -> dict[str, Evidence]:
    """The evidence, with each camera's delays as of the row time of all episodes, where these tell
    it better than the episode alone."""
    found = dict(evidence)
    cameras = {camera for name in names for camera in evidence[name]["cameras"]}
    pooled = {camera: pooled_row_time(camera, names, evidence) for camera in cameras}
    for name in names:
        figures = dict(evidence[name]["figures"])
        for figure, (share, at) in evidence[name].get("row_shares", {}).items():
            rolling = pooled.get(figure.partition("delay/")[2])
            value, std, shared, where = figures[figure]
            if rolling is None or std is None or abs(share) * rolling.std >= shared:
                continue
            left = abs(share) * rolling.std
            total = float(np.hypot(own_std(std, shared), left))
            figures[figure] = [value + share * (rolling.mean - at), total, left, where]
        found[name] = {**evidence[name], "figures": figures}
    return found


def _with_delays(row: Row, alone: Mapping[str, Evidence], together: Mapping[str, Evidence]) -> Row:
    """A row with its delays as of the row time of all episodes, and what they are alone."""
    if row["name"] not in alone:
        return row
    scores = dict(row["scores"])
    texts = list[list[str]]()
    before = alone[row["name"]]["figures"]
    for figure, (value, std, *_) in together[row["name"]]["figures"].items():
        if before[figure][:2] == [value, std] or figure not in scores:
            continue
        scores[figure] = value
        scores[f"std/{figure}"] = std
        shown, own = (
            f"{1e3 * x:.1f} ± {1e3 * s:.1f} ms" for x, s in ((value, std), before[figure][:2])
        )
        texts.append(["info", f"{figure}: {shown} by the row time of all episodes, alone {own}"])
    return {**row, "scores": scores, "findings": [*row["findings"], *texts]}


def pooled_row_time(
    camera: str, names: Sequence[str], evidence: Mapping[str, Evidence]
) -> PooledFigure | None:
    """The time (s) that a camera's rolling shutter takes, over episodes; None of fewer than
    LEAST_EPISODES, of which the scatter does not tell the error."""
    known = [evidence[name]["figures"].get(f"row_time/{camera}") for name in names]
    summary_findings = np.array(
        [(one[0], one[1]) for one in known if one is not None and one[1] is not None]
    )
    return pool_values(*summary_findings.T) if len(summary_findings) >= LEAST_EPISODES else None


def _dataset_scores(
    rows: Sequence[Row],
    evidence: Mapping[str, Evidence],
    outliers: Sequence[StandsOut],
    pooled: Mapping[str, PooledDelay],
    views: Sequence[Mapping[str, Views]],
) -> Iterator[Score]:
    """Scores of the whole dataset: counts, pooled delays, and medians of shares and rates over
    episodes."""
    yield Score("episodes", float(len(rows)), "1")
    yield Score("outliers", float(len({one.episode for one in outliers})), "1")
    for figure, one in pooled.items():
        yield Score(figure, one.mean, "s", one.std)
        yield Score(f"std/{figure}", one.std, "s")
        yield Score(f"jitter/{figure}", one.jitter, "s")
        if figure.startswith("flow/"):
            continue
        rolling = pooled_row_time(figure.partition("/")[2], list(evidence), evidence)
        if rolling is not None:
            yield Score(f"row_time/{figure.partition('/')[2]}", rolling.mean, "s", rolling.std)
    for camera in sorted({camera for own in views for camera in own}):
        farthest = max(float(np.nanmax(own[camera].moved_px)) for own in views if camera in own)
        yield Score(f"moved/{camera}", farthest, "px")
    for figure in _list_median_figures(evidence):
        yield Score(
            figure, _median_over_episodes(figure, evidence), BY_NAME[figure.partition("/")[0]].unit
        )


def _list_median_figures(evidence: Mapping[str, Evidence]) -> list[str]:
    kinds = ("repeated", "rate", "dropped", "frozen", "black", "saturated", "idle")
    return sorted(
        {f for one in evidence.values() for f in one["figures"] if f.partition("/")[0] in kinds}
    )


def _median_over_episodes(figure: str, evidence: Mapping[str, Evidence]) -> float:
    values = [one["figures"][figure][0] for one in evidence.values() if figure in one["figures"]]
    return float(np.median(values))


def _dataset_verdict(
    rows: Sequence[Row],
    names: Sequence[str],
    evidence: Mapping[str, Evidence],
    outliers: Sequence[StandsOut],
    differing: Sequence[StandsOut],
    pooled: Mapping[str, PooledDelay],
    whole: Sequence[str],
) -> Iterator[str]:
    """How many episodes there are and stand out, then what is wrong with all of them, then with the
    files."""
    seconds = sum(evidence[name]["duration_s"] for name in names)
    unusable = [row["name"] for row in rows if row["exit_code"] not in (0, 3, 4)]
    odd = list(dict.fromkeys(one.episode for one in outliers))
    text = f"{len(rows)} episodes, {seconds:.0f} s"
    text += (
        f"; {len(odd)} stand out: {list_in_words(odd)}"
        if odd
        else "; none stands out from the others"
    )
    text += f"; {len(unusable)} cannot be used: {list_in_words(unusable)}" if unusable else ""
    yield text
    yield from _loss_sentences(rows)
    yield from _declaration_sentences(rows)
    others = [f"{one.episode} ({min(one.figures, key=_check_rank)})" for one in differing]
    if others:
        yield f"differ from the others, perhaps for good reasons: {list_in_words(others)}"
    yield from _camera_sentences(evidence)
    yield from _arm_sentences(evidence)
    for figure, one in pooled.items():
        yield _delay_sentence(figure, one, len(names))
        if figure.startswith("flow/"):
            continue
        rolling = pooled_row_time(figure.partition("/")[2], names, evidence)
        if rolling is not None and rolling.mean > SIGNIFICANT_SIGMA * rolling.std:
            size = f"{1e3 * rolling.mean:.0f} ± {1e3 * rolling.std:.0f} ms"
            yield f"{figure.partition('/')[2]}: a rolling shutter takes {size} over the image"
    yield from _joint_sentences(names, evidence)
    yield from whole


def _loss_sentences(rows: Sequence[Row]) -> Iterator[str]:
    """Which episodes lost a part, and what the first of them lost."""
    lost = {
        row["name"]: text.removeprefix(f"{row['log']}: ")
        for row in rows
        for severity, text in row["findings"][::-1]
        if severity == "lost"
    }
    names = list(lost)
    if names:
        whose = f"{len(names)} of {len(rows)} episodes lost a part: {list_in_words(names)}"
        yield f"{whose}; {lost[names[0]]}"


def _declaration_sentences(rows: Sequence[Row]) -> Iterator[str]:
    """What a dataset's lists say otherwise than the files of episodes, each once."""
    found: dict[str, list[str]] = {}
    for row in rows:
        for severity, text in row["findings"]:
            if severity == "warning" and any(word in text for word in _OF_LISTS):
                found.setdefault(text.removeprefix(f"{row['log']}: "), []).append(row["name"])
    for text, names in list(found.items())[:MOST_DECLARATIONS]:
        yield f"{text}, in {len(names)} of {len(rows)} episodes: {list_in_words(names)}"


def _camera_sentences(evidence: Mapping[str, Evidence]) -> Iterator[str]:
    """True frame rates, and cameras of whose pictures a share is lost to a learner."""
    for figure in _list_median_figures(evidence):
        kind, _, camera = figure.partition("/")
        if (
            kind == "repeated"
            and (share := _median_over_episodes(figure, evidence)) >= REPORTED_SHARE
        ):
            stored = [
                one["cameras"][camera]["stored_hz"]
                for one in evidence.values()
                if camera in one["cameras"]
            ]
            known = [hz for hz in stored if hz is not None]
            if known:
                hz = float(np.median(known))
                distinct = f"{hz:.3g} Hz, of which {hz * (1.0 - share):.2g} distinct"
                yield f"{camera}: {distinct}: {100.0 * share:.0f} % repeat the one before"
        elif kind in ("frozen", "black", "saturated", "dropped"):
            figures = {
                name: one["figures"].get(figure, (0.0,))[0] for name, one in evidence.items()
            }
            some = [name for name, share in figures.items() if share >= REPORTED_SHARE]
            if some:
                count = f"{len(some)} of {len(evidence)} episodes"
                yield f"{camera}: {kind} images in {count}: {list_in_words(some)}"


def _arm_sentences(evidence: Mapping[str, Evidence]) -> Iterator[str]:
    """The arm, of several, with which each camera's picture moves, and the episodes in which it is
    another."""
    arms: dict[str, dict[str, list[str]]] = {}
    for name, one in evidence.items():
        for camera, about in one["cameras"].items():
            if about.get("arm"):
                arms.setdefault(camera, {}).setdefault(about["arm"], []).append(name)
    for camera, episodes in sorted(arms.items()):
        (most, agreeing), *others = sorted(episodes.items(), key=lambda one: -len(one[1]))
        text = f"{camera}: its picture moves with {most}, in {len(agreeing)} of {len(evidence)}"
        text += " episodes"
        for arm, some in others:
            text += f"; with {arm} in {list_in_words(some)}"
        yield text + ("; cameras are exchanged, or another arm works there" if others else "")


def _delay_sentence(figure: str, one: PooledDelay, episodes: int) -> str:
    mean = one.mean
    std = one.std
    size = f"{1e3 * abs(mean):.0f} ± {1e3 * std:.0f} ms"
    between = f", jitter {1e3 * one.jitter:.0f} ms between episodes" if one.jitter > 0.0 else ""
    if one.shared_std > one.own_std:
        between += f"; ± {1e3 * one.shared_std:.0f} ms of it are the method's, --urdf has less"
    if figure == "delay/action":
        return f"the state follows the action after {size}{between}"
    name = figure.partition("delay/")[2]
    if figure.startswith("flow/"):
        way = "late" if mean > 0.0 else "early"
        return f"{name}: by the picture's motion alone they are {size} {way}{between}"
    if one.by_surface:
        between += f"; by the robot's surface in {one.by_surface} of {episodes} episodes"
    if abs(mean) <= SIGNIFICANT_SIGMA * std:
        return f"{name}: no delay is significant ({size}{between})"
    return (
        f"{name}: images are {size} {'late' if mean > 0.0 else 'early'} against the joints{between}"
    )


def _joint_sentences(names: Sequence[str], evidence: Mapping[str, Evidence]) -> Iterator[str]:
    """Joints that never move, units that differ, and stamps that are row numbers."""
    joints = [evidence[name]["joints"] for name in names if evidence[name]["joints"] is not None]
    still = Counter[str]()
    for name in names:
        figures = evidence[name]["figures"]
        still.update(
            f.partition("/")[2] for f, pair in figures.items() if f.startswith("still/") and pair[0]
        )
    never = [joint for joint, count in still.items() if count == len(joints)]
    if never:
        yield f"never moved in any episode: {list_in_words(never)}"
    units = Counter(one["unit"] for one in joints)
    if len(units) > 1:
        shown = ", ".join(f"{text[:60]} in {count}" for text, count in units.most_common(3))
        yield f"the episodes differ in their units: {shown}"
    jitters = [evidence[name]["figures"].get("stamp_jitter/joints", (None,))[0] for name in names]
    if jitters and all(one == 0.0 for one in jitters):
        yield "stamps are row numbers over the rate: they tell nothing of when a picture was taken"
