"""Updating a body learned with a URDF keeps its chain and its earlier samples."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import body
from bodylog.body.kinematic import update
from bodylog.body.kinematic.learn import learn_kinematics
from bodylog.body.kinematic.model import KinematicGP
from bodylog.errors import EvidenceError
from bodylog.kinematics import urdf
from bodylog.kinematics.pose import find_base
from bodylog.settings import KinematicsSettings, Settings
from tests.body.kinematic_arms import OFFSETS, features, given
from tests.kinematics import robots
from tests.kinematics.robots import ARM


@pytest.fixture(scope="module")
def known():
    model = learn_kinematics([features(25)], Settings(), body.learn_body([features(25)], Settings(), {}), given()).model
    sense = model.senses["effector"]
    return replace(
        model, senses={"effector": replace(sense, base=find_base(urdf.parse_urdf(ARM, "arm"), sense.rig, sense.theta, {}))}
    )


def _updated(known, more, settings=None):
    settings = settings or Settings()
    plain = body.learn_body([more], settings, {}, known)
    return plain, body.with_kinematics([more], settings, plain, None, known)


def test_update_keeps_chain_and_base_and_reduces_uncertainty(known):
    _, found = _updated(known, features(25, seed=7))
    before, after = known.senses["effector"], found.model.senses["effector"]
    assert isinstance(after, KinematicGP) and len(after.samples) == 50
    assert after.base is before.base and after.rig.sights[0].chain.end == before.rig.sights[0].chain.end
    zeros = {s.name: s.value for s in found.scores}
    for name, true in OFFSETS.items():
        index = after.rig.of_joints.start + after.rig.joints.index(name)
        assert zeros[f"std/offset/{name}"] < 0.9 * np.sqrt(np.square(before.root[index]).sum())
        assert abs(zeros[f"offset/{name}"] - true) < 3 * zeros[f"std/offset/{name}"]
    q = robots.angles(200, seed=9)
    rig = robots.rig(known=False)
    true = rig.see(rig.sights[0], robots.truth(rig, OFFSETS), q).image[:, 0]
    errors = [np.sqrt(np.square(sense.kinematics(q) - true).mean()) for sense in (before, after)]
    assert errors[1] < 1.2 * errors[0]


def test_learn_without_a_urdf_uses_no_kinematics(known):
    plain, found = _updated(known, features(25, seed=7), Settings(kinematics=KinematicsSettings(use=False)))
    assert set(found.model.senses) == set(plain.model.senses)
    assert not any(isinstance(sense, KinematicGP) for sense in found.model.senses.values())


def test_update_names_a_moved_camera_and_ignores_the_chain(known):
    more = features(60, seed=7)
    track = more.tracks["effector"]
    turned = replace(track, values=track.values[:, ::-1] * [1.3, -1.0] + [40.0, 300.0])
    moved = replace(more, tracks={"effector": turned})
    hopeful = body.learn_body([moved], Settings(), {}, known, keep="all")
    found = update.update_kinematics([moved], Settings(), hopeful, known)
    assert found.model is hopeful.model and "the URDF is not used" in found.findings[-1].text
    with pytest.raises(EvidenceError, match="no track can be learned"):
        body.with_kinematics([moved], Settings(), hopeful, None, known)
