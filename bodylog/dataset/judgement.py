"""A dataset judged: episodes that stand out from their siblings, and a verdict in a few sentences."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..types import Array, Score
from ..wording import listed
from .checks import BY_NAME, Check
from .siblings import Outlier, find_outliers, pool, without_nan

Row = dict[str, Any]
Evidence = Mapping[str, Any]
"""An episode's evidence (see examination.evidence)."""
UNIT_RATIO = 3.0
"""Factor between the sizes of an episode's joints and its siblings' from which their unit is another."""
UNIT_AGREEMENT = 0.35
"""Largest difference of that factor's logarithm between joints."""
DEGREES_PER_RAD = 57.29578
SWAP_SHARE = 0.5
"""Distance of a swapped joint from the other's siblings, over its distance from its own."""
SIGNIFICANT_SIGMA = 2.0
STALE_STATISTICS = 0.02
"""Error of a stored statistic that is reported, over the feature's range."""


@dataclass(frozen=True)
class StandsOut:
    """An episode that stands out from its siblings: its name, what in, and the sentence about it."""

    episode: str
    figures: tuple[str, ...]
    z: float
    text: str


@dataclass(frozen=True, eq=False)
class DatasetJudgement:
    """rows, each with what its siblings say of it · evidence {row's name: Evidence} · verdict in sentences · scores of
    the whole, their standard errors beside · outliers, the farthest first."""

    rows: list[Row]
    evidence: Mapping[str, Evidence]
    verdict: tuple[str, ...]
    scores: tuple[Score, ...]
    outliers: tuple[StandsOut, ...]
    findings: tuple[str, ...] = ()
    pooled: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)


def judge(rows: Sequence[Row], evidence: Mapping[str, Evidence], findings: Sequence[str] = ()) -> DatasetJudgement:
    """Judge the rows of a dataset's episodes; `findings`: what is wrong with the dataset's own files."""
    names = [row["name"] for row in rows if row["name"] in evidence]
    outliers = tuple(sorted(_outliers(names, evidence), key=lambda one: -one.z))
    told = [_with_outliers(row, [one for one in outliers if one.episode == row["name"]]) for row in rows]
    doubles = tuple(_duplicates(names, evidence))
    pooled = _pooled(names, evidence)
    scores = tuple(_scores(rows, evidence, outliers, pooled))
    whole = (*findings, *doubles)
    verdict = tuple(_verdict(rows, names, evidence, outliers, pooled, whole))
    return DatasetJudgement(told, evidence, verdict, scores, outliers, whole, pooled)


def _with_outliers(row: Row, outliers: Sequence[StandsOut]) -> Row:
    texts = [["warning", one.text] for one in outliers]
    verdict = [one.text for one in outliers] or list(row["verdict"])
    return {**row, "findings": [*row["findings"], *texts], "verdict": verdict}


def _outliers(names: Sequence[str], evidence: Mapping[str, Evidence]) -> Iterator[StandsOut]:
    """Episodes that stand out, each cause once: a wrong unit or swapped joints explain all else about these joints."""
    table = _compared(names, evidence)
    looks = sum(int(np.isfinite(values).sum()) for values, _, _ in table.values())
    found: dict[tuple[int, str], Outlier] = {}
    for figure, (values, std, resolution) in table.items():
        for one in find_outliers(values, std, resolution, looks):
            found[one.number, figure] = one
    for number in sorted({number for number, _ in found}):
        own = {figure: one for (k, figure), one in found.items() if k == number}
        yield from _told(names[number], own, table)


def _compared(
    names: Sequence[str], evidence: Mapping[str, Evidence]
) -> dict[str, tuple[Array, Array, float]]:
    """Values, standard errors (N,) and resolution of each figure by which siblings are compared."""
    figures = sorted({figure for name in names for figure in evidence[name]["figures"]})
    found = {}
    for figure in figures:
        check = check_of(figure)
        if check is None or check.resolution is None:
            continue
        pairs = [evidence[name]["figures"].get(figure, (None, None)) for name in names]
        values = np.array([np.nan if value is None else value for value, _ in pairs])
        resolution = check.resolution
        if check.unit == "joint":
            resolution *= _span(figure.partition("/")[2], names, evidence)
        found[figure] = (values, without_nan([std for _, std in pairs]), max(resolution, 1e-9))
    return found


def check_of(figure: str) -> Check | None:
    """The check of a figure."""
    return BY_NAME.get(figure) or BY_NAME.get(figure.partition("/")[0])


def _span(joint: str, names: Sequence[str], evidence: Mapping[str, Evidence]) -> float:
    """What a joint, or the widest of all, moves in an episode, at the median over episodes."""
    spans = []
    for name in names:
        joints = evidence[name]["joints"]
        if joints is None:
            continue
        own = {
            one: np.ptp([value for value in curve if value is not None] or [0.0])
            for one, curve in zip(joints["names"], joints["curves"], strict=True)
        }
        spans.append(own[joint] if joint in own else max(own.values(), default=0.0))
    return float(np.median(spans)) if spans else 0.0


_JOINT_FIGURES = ("start", "mean", "size", "longest_repeat", "clipped", "still", "error")


def _told(
    episode: str, own: Mapping[str, Outlier], table: Mapping[str, tuple[Array, Array, float]]
) -> Iterator[StandsOut]:
    """The causes that explain what is odd of an episode, the strongest explanations first."""
    left = dict(own)
    yield from _other_unit(episode, left, table)
    yield from _swapped(episode, left, table)
    for part in sorted({figure.partition("/")[2] for figure in left}):
        group = {figure: one for figure, one in left.items() if figure.partition("/")[2] == part}
        # the figure that says most of the cause comes first in the table of checks
        order = list(BY_NAME)
        first = min(group, key=lambda figure: order.index(_name(figure)))
        yield StandsOut(episode, tuple(sorted(group)), max(one.z for one in group.values()), _text(first, group[first]))


def _name(figure: str) -> str:
    check = check_of(figure)
    return "" if check is None else check.name


def _other_unit(
    episode: str, left: dict[str, Outlier], table: Mapping[str, tuple[Array, Array, float]]
) -> Iterator[StandsOut]:
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


def _swapped(
    episode: str, left: dict[str, Outlier], table: Mapping[str, tuple[Array, Array, float]]
) -> Iterator[StandsOut]:
    """Two joints of which each has the other's usual posture."""
    for name in ("mean", "start"):
        odd = {figure.partition("/")[2]: one for figure, one in left.items() if figure.startswith(f"{name}/")}
        for a in sorted(odd):
            for b in sorted(odd):
                if a < b and a in odd and b in odd and _exchanged(odd[a], odd[b]):
                    figures = tuple(figure for figure in left if figure.partition("/")[2] in (a, b))
                    z = max(left[figure].z for figure in figures)
                    for figure in figures:
                        del left[figure]
                    del odd[a], odd[b]
                    text = f"{a} and {b} are swapped: each reads what the other reads in the other episodes"
                    yield StandsOut(episode, figures, z, text)
                    break


def _exchanged(a: Outlier, b: Outlier) -> bool:
    """Whether each value is near the other's siblings and far from its own."""
    near = max(abs(a.value - b.others), abs(b.value - a.others))
    return near < SWAP_SHARE * min(abs(a.value - a.others), abs(b.value - b.others))


def _text(figure: str, one: Outlier) -> str:
    check = check_of(figure)
    assert check is not None
    unit = {"s": "s", "1": "", "joint": ""}.get(check.unit, check.unit)
    value = f"{one.value:.3g} {unit}".strip()
    others = f"{one.others:.3g} ± {one.spread:.2g} {unit}".strip()
    return (
        f"{figure} is {value}, of the others {others}: {one.z:.0f} σ, "
        f"{one.bound:.1f} are the bound for all looks together; to a learner, {check.cost}"
    )


def _duplicates(names: Sequence[str], evidence: Mapping[str, Evidence]) -> Iterator[str]:
    """Episodes whose joints and actions are equal in every number."""
    digests = Counter(evidence[name]["digest"] for name in names if evidence[name]["digest"])
    for digest, count in digests.items():
        if count > 1:
            same = [name for name in names if evidence[name]["digest"] == digest]
            yield f"{' and '.join(same)} are the same episode: equal in every number"


def _pooled(names: Sequence[str], evidence: Mapping[str, Evidence]) -> dict[str, tuple[float, float, float]]:
    """Delays over episodes {figure: (mean, standard error, jitter)} (s)."""
    figures = sorted({f for name in names for f in evidence[name]["figures"] if f.startswith("delay/")})
    found = {}
    for figure in figures:
        pairs = [evidence[name]["figures"][figure] for name in names if figure in evidence[name]["figures"]]
        told = [(value, std) for value, std in pairs if value is not None and std is not None]
        if told:
            one = pool(np.array([value for value, _ in told]), np.array([std for _, std in told]))
            found[figure] = (one.mean, one.std, one.jitter)
    return found


def _scores(
    rows: Sequence[Row], evidence: Mapping[str, Evidence], outliers: Sequence[StandsOut],
    pooled: Mapping[str, tuple[float, float, float]],
) -> Iterator[Score]:  # fmt: skip
    """Scores of the whole dataset: counts, pooled delays, and medians of shares and rates over episodes."""
    yield Score("episodes", float(len(rows)), "1")
    yield Score("outliers", float(len({one.episode for one in outliers})), "1")
    for figure, (mean, std, jitter) in pooled.items():
        yield Score(figure, mean, "s", std)
        yield Score(f"std/{figure}", std, "s")
        yield Score(f"jitter/{figure}", jitter, "s")
    for figure in _medians(evidence):
        yield Score(figure, _median(figure, evidence), BY_NAME[figure.partition("/")[0]].unit)


def _medians(evidence: Mapping[str, Evidence]) -> list[str]:
    kinds = ("repeated", "rate", "dropped", "frozen", "black", "idle")
    return sorted({f for one in evidence.values() for f in one["figures"] if f.partition("/")[0] in kinds})


def _median(figure: str, evidence: Mapping[str, Evidence]) -> float:
    values = [one["figures"][figure][0] for one in evidence.values() if figure in one["figures"]]
    return float(np.median(values))


def _verdict(
    rows: Sequence[Row], names: Sequence[str], evidence: Mapping[str, Evidence], outliers: Sequence[StandsOut],
    pooled: Mapping[str, tuple[float, float, float]], whole: Sequence[str],
) -> Iterator[str]:  # fmt: skip
    """How many episodes there are and stand out, then what is wrong with all of them, then with the files."""
    seconds = sum(evidence[name]["duration_s"] for name in names)
    unusable = [row["name"] for row in rows if row["exit_code"] not in (0, 3, 4)]
    odd = list(dict.fromkeys(one.episode for one in outliers))
    text = f"{len(rows)} episodes, {seconds:.0f} s"
    text += f"; {len(odd)} stand out: {listed(odd)}" if odd else "; none stands out from the others"
    text += f"; {len(unusable)} cannot be used: {listed(unusable)}" if unusable else ""
    yield text
    yield from _camera_sentences(evidence)
    for figure, (mean, std, jitter) in pooled.items():
        yield _delay_sentence(figure, mean, std, jitter)
    yield from _joint_sentences(names, evidence)
    yield from whole


def _camera_sentences(evidence: Mapping[str, Evidence]) -> Iterator[str]:
    """True frame rates, and pictures that are lost to a learner in most episodes."""
    for figure in _medians(evidence):
        kind, _, camera = figure.partition("/")
        share = _median(figure, evidence)
        if kind == "repeated" and share >= 0.05:
            stored = [one["cameras"][camera]["stored_hz"] for one in evidence.values() if camera in one["cameras"]]
            known = [hz for hz in stored if hz is not None]
            if known:
                hz = float(np.median(known))
                distinct = f"{hz:.3g} Hz, of which {hz * (1.0 - share):.2g} distinct"
                yield f"{camera}: {distinct}: a learner sees each picture twice"
        elif kind in ("frozen", "black", "dropped") and share >= 0.05:
            yield f"{camera}: {100.0 * share:.0f} % of its images are {kind} in most episodes"


def _delay_sentence(figure: str, mean: float, std: float, jitter: float) -> str:
    size = f"{1e3 * abs(mean):.0f} ± {1e3 * std:.0f} ms"
    between = f", jitter {1e3 * jitter:.0f} ms between episodes" if jitter > 0.0 else ""
    if figure == "delay/action":
        return f"the state follows the action after {size}{between}"
    name = figure.partition("/")[2]
    if abs(mean) <= SIGNIFICANT_SIGMA * std:
        return f"{name}: no delay is significant ({size}{between})"
    return f"{name}: images are {size} {'late' if mean > 0.0 else 'early'} against the joints{between}"


def _joint_sentences(names: Sequence[str], evidence: Mapping[str, Evidence]) -> Iterator[str]:
    """Joints that never move, units that differ, and stamps that are row numbers."""
    joints = [evidence[name]["joints"] for name in names if evidence[name]["joints"] is not None]
    still = Counter[str]()
    for name in names:
        figures = evidence[name]["figures"]
        still.update(f.partition("/")[2] for f, pair in figures.items() if f.startswith("still/") and pair[0])
    never = [joint for joint, count in still.items() if count == len(joints)]
    if never:
        yield f"never moved in any episode: {listed(never)}"
    for what, values in (("units", [one["unit"] for one in joints]), ("joints", [str(one["names"]) for one in joints])):
        kinds = Counter(values)
        if len(kinds) > 1:
            shown = ", ".join(f"{text[:60]} in {count}" for text, count in kinds.most_common(3))
            yield f"the episodes differ in their {what}: {shown}"
    jitters = [evidence[name]["figures"].get("stamp_jitter/joints", (None,))[0] for name in names]
    if jitters and all(one == 0.0 for one in jitters):
        yield "stamps are row numbers over the rate: they tell nothing of when a picture was taken"
