from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodylog import pipeline
from bodylog.errors import EvidenceError, LogError, OutputError, UsageError
from bodylog.evaluation.scores import score_angles
from bodylog.logs.formats import open_log
from bodylog.settings import Settings


@pytest.mark.parametrize("out", ["a.mcap", "b.mcap", "body.npz", "link.npz"])
def test_pipeline_refuses_to_overwrite_its_inputs(out: str, tmp_path: Path) -> None:
    first, second, body = (tmp_path / name for name in ("a.mcap", "b.mcap", "body.npz"))
    for path in (first, second, body):
        path.write_bytes(b"precious")
    (tmp_path / "link.npz").symlink_to(body)
    with pytest.raises(UsageError, match=f"{out} is also an input"):
        pipeline.fit([first, second], tmp_path / out, Settings(), update=body)
    if out != "b.mcap":
        with pytest.raises(UsageError, match=f"{out} is also an input"):
            pipeline.estimate(first, body, tmp_path / out, Settings())
    assert all(path.read_bytes() == b"precious" for path in (first, second, body))


@pytest.mark.parametrize("stage", ["observe", "estimate_log", "estimate_messages"])
@pytest.mark.parametrize("problem", [EvidenceError("no joints"), KeyboardInterrupt()])
def test_interrupted_estimate_leaves_nothing(tmp_path, monkeypatch, arm, arm_body, stage, problem) -> None:
    def ends(*_: object) -> None:
        assert len(list(tmp_path.iterdir())) == 2  # the copy is under way
        raise problem

    log = tmp_path / "in.mcap"
    log.write_bytes((arm / "touch.mcap").read_bytes())
    monkeypatch.setattr(pipeline, stage, ends)
    with pytest.raises(type(problem)):
        pipeline.estimate(log, arm_body, tmp_path / "out.mcap", Settings())
    assert list(tmp_path.iterdir()) == [log]


def test_impossible_output_is_refused_before_reading(tmp_path, monkeypatch, arm, arm_body) -> None:
    monkeypatch.setattr(pipeline, "observe", lambda *_: pytest.fail("the log was read"))
    with pytest.raises(OutputError, match="mkdir -p"):
        pipeline.estimate(arm / "touch.mcap", arm_body, tmp_path / "no" / "out.mcap", Settings())


def test_encoders_that_read_no_angles_are_scored_by_none():
    from bodylog.body import Polynomial
    from bodylog.settings import EstimationSettings
    from tests.estimation.conftest import draw

    drawn = draw(0, duration=4.0)
    doubled = Polynomial(drawn.body.joints, np.tile([0.0, 2.0], (3, 1)))
    body = replace(drawn.body, senses={**drawn.body.senses, "encoders": doubled})
    joints = drawn.features.joints
    features = replace(drawn.features, joints=replace(joints, values=2.0 * joints.values))
    settings = Settings(estimate=EstimationSettings(method="predictive-coding", start=tuple(drawn.truth.values[0])))
    found = pipeline.infer(features, body, settings)
    assert not [score.name for score in score_angles(found, drawn.truth, features.joints) if score.name.startswith("encoder")]
    assert any("rmse/encoders is left out" in finding.text for finding in found.findings)


def test_fit_names_a_log_without_joints(tmp_path, monkeypatch, arm) -> None:
    read, features = pipeline.observe(arm / "touch.mcap", Settings())
    monkeypatch.setattr(pipeline, "observe", lambda *_, **__: (read, replace(features, joints=None)))
    with pytest.raises(LogError, match=r"touch\.mcap: no joint readings to learn from"):
        pipeline.fit([arm / "touch.mcap"], tmp_path / "body.npz", Settings())
    assert not list(tmp_path.iterdir())


def test_estimate_rejects_images_of_another_width_unless_unused(tmp_path, arm, arm_body) -> None:
    from bodylog.body import storage
    from bodylog.compare import compare_methods
    from bodylog.errors import ModelError
    from bodylog.settings import EstimationSettings

    body, known = tmp_path / "wide.npz", storage.load_body(arm_body)
    storage.save(replace(known, provenance={**known.provenance, "image_width": 640}), body)
    out, log = tmp_path / "out.mcap", arm / "reach.mcap"
    for run in (lambda: pipeline.estimate(log, body, out, Settings()), lambda: compare_methods(log, body, Settings())):
        with pytest.raises(ModelError, match=r"320 px wide, 640 px where .* --without vision,touch"):
            run()
    assert not out.exists()
    pipeline.estimate(log, body, out, Settings(estimate=EstimationSettings(without=("vision", "touch"))))
    assert out.exists()


def test_constant_encoder_offset_may_be_the_camera() -> None:
    from bodylog.findings.faults import fault_warnings
    from bodylog.types import Fault, FaultKind

    given = ((FaultKind.DRIFTING, 0.2), (FaultKind.DRIFTING, 9.0), (FaultKind.JUMPING, 0.2))
    first, later, jump = fault_warnings([Fault("encoders", "a", kind, since, 0.1, "rad") for kind, since in given])
    assert first.text == (
        "encoders a: drifting since 0.200 s, 0.1 rad (5.73°); from the start: homed differently, or the camera moved "
        "since the body was learned"
    )
    assert later.text == "encoders a: drifting since 9.000 s, 0.1 rad (5.73°)"
    assert jump.text.endswith("0.1 rad (5.73°)")


def test_progress_counts_the_messages_or_images_of_the_whole_log(tmp_path):
    log = Path(__file__).parents[1] / "fixtures" / "arm" / "reach.mcap"
    with open_log(log) as opened:
        messages = {topic.name: topic.messages for topic in opened.topics}
    done: dict[str, list[int]] = {"doctor": [], "convert": [], "ingest": []}
    pipeline.diagnose_log(log, progress=done["doctor"].append)
    pipeline.convert([log], tmp_path / "c.mcap", Settings(), progress=done["convert"].append)
    pipeline.ingest(log, tmp_path / "i.mcap", Settings(), progress=done["ingest"].append)
    whole = sum(messages.values())
    assert {name: sum(found) for name, found in done.items()} == {
        "doctor": whole, "convert": whole, "ingest": messages["/camera/color/image_raw/compressed"],
    }  # fmt: skip
