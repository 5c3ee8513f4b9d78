"""Joints that a log and a URDF spell differently."""

from bodylog.kinematics.joint_names import match_joints


def test_words_match_across_spellings():
    known = ["left_shoulder_pitch_joint", "right_shoulder_pitch_joint", "left_elbow_joint", "waist_yaw_joint"]
    found = match_joints(["kLeftShoulderPitch", "kLeftElbow", "kRightShoulderPitch", "kLeftHandPinky"], known)
    assert found == {
        "kLeftShoulderPitch": "left_shoulder_pitch_joint",
        "kLeftElbow": "left_elbow_joint",
        "kRightShoulderPitch": "right_shoulder_pitch_joint",
    }


def test_same_name_wins_over_same_words():
    assert match_joints(["elbow_joint", "elbow"], ["elbow_joint"]) == {"elbow_joint": "elbow_joint"}


def test_numbers_count_and_ambiguous_names_are_left_out():
    assert match_joints(["joint2"], ["joint_1", "joint_2"]) == {"joint2": "joint_2"}
    assert match_joints(["elbow"], ["elbow_joint", "elbow_link_joint"]) == {}
    assert match_joints(["0", "pan.pos"], ["pan", "lift"]) == {"pan.pos": "pan"}
