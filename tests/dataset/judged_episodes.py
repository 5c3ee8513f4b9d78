"""Episodes examined one by one, and judged together."""

from pathlib import Path
from typing import Any

from bodylog.dataset.examination import examine_episode
from bodylog.dataset.judgement import DatasetJudgement, judge_episodes
from bodylog.io import episodes
from bodylog.settings import Settings


def examined(folder: Path, stored: int, number: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """The row and the evidence of episode `number`, which is stored as episode `stored`."""
    result, evidence = examine_episode(episodes.name_episode(folder, stored), Settings(), str(number))
    scores = {one.name: one.value for one in result.scores}
    findings = [[one.severity, one.text] for one in result.findings]
    row = {
        "name": str(number),
        "exit_code": 0,
        "findings": findings,
        "verdict": [],
        "scores": scores,
    }
    return row, evidence


def judged(found: dict[int, tuple[dict[str, Any], dict[str, Any]]]) -> DatasetJudgement:
    """The judgement on rows and evidence by episode."""
    return judge_episodes(
        [row for row, _ in found.values()], {str(number): one for number, (_, one) in found.items()}
    )
