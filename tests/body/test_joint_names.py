"""Labels of skeletons are told from those of markers by the whole set."""

import pytest

from solver_backend.body.body import load_body
from solver_backend.body.joint_names import joint_centre_places
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import name_markers
from solver_backend.body.markers import marker_landmarks, placement_precision
from solver_backend.exchange.joint_sets import SMPL_JOINTS, JointSet
from solver_backend.io.motions.recorded_clip import MAPS
from tests.support.label_systems import SKELETONS, SYSTEMS
from tests.support.skeleton_labels import POSE2SIM, SUIT


def test_bones_are_named_by_where_they_begin():
    places = joint_centre_places(SUIT)
    assert (
        places["LeftThigh"] == "=left_hip" and places["LeftLeg"] == "=left_knee" and places["LeftFoot"] == "=left_ankle"
    )
    assert places["RightArm"] == "=right_shoulder" and places["RightForearm"] == "=right_elbow"
    assert places["RightHand"] == "=right_wrist" and places["RightShoulder"] == "" and places["SpineMid"] == ""
    assert places["Hips"] == "=pelvis" and places["LeftToe"] == "=left_foot"


def test_names_as_blender_and_mixamo_write_them():
    places = joint_centre_places(
        [f"mixamorig:{n.replace('Thigh', 'UpLeg').replace('Forearm', 'ForeArm')}" for n in SUIT]
    )
    assert places["mixamorig:LeftUpLeg"] == "=left_hip" and places["mixamorig:RightForeArm"] == "=right_elbow"


def test_keypoints_are_what_detectors_mean():
    places = joint_centre_places(POSE2SIM)
    assert places["CHip"] == "~mid_hip" and places["LHip"] == "~left_hip" and places["RBigToe"] == "~right_big_toe"


@pytest.mark.parametrize("joint_set", [s for s in JointSet if s is not JointSet.SMPL_24])
def test_every_joint_set_is_recognised(joint_set):
    places = joint_centre_places(joint_set.keypoints)
    assert set(places) == set(joint_set.keypoints)
    assert all(place[:1] in ("~", "=", "") for place in places.values())


def test_joints_without_a_face_are_a_skeleton():
    places = joint_centre_places(SMPL_JOINTS)
    assert places["left_hip"] == "=left_hip" and places["right_ankle"] == "=right_ankle" and places["head"] == "=head"


@pytest.mark.parametrize("family", ["segments", "mb2", "expmap", "max", "makehuman", "jump"])
def test_skeletons_of_recordings_are_recognised(family):
    skeleton = next(m for m in MAPS if m.family == family)
    places = joint_centre_places(list(dict.fromkeys(skeleton.joints)))
    assert {f"={side}_{part}" for side in ("left", "right") for part in ("hip", "knee", "ankle", "elbow")} <= set(
        places.values()
    )


@pytest.mark.parametrize("name", [*load_layouts().layouts, *load_layouts().label_sets])
def test_layouts_of_markers_are_no_skeletons(name):
    file = load_layouts()
    assert not joint_centre_places((file.layouts | file.label_sets)[name])


def test_a_few_words_of_a_skeleton_among_markers_mean_markers():
    labels = (
        "LASI",
        "RASI",
        "SACR",
        "LThigh",
        "LKnee",
        "LAnkle",
        "LHeel",
        "LToe",
        "RThigh",
        "RKnee",
        "RAnkle",
        "RHeel",
    )
    assert not joint_centre_places(labels)
    assert name_markers(labels).known["LKnee"] == "LKNE"


def test_no_label_is_not_a_word():
    assert not joint_centre_places([]) and not joint_centre_places(["", "Hips"])


def test_what_a_person_says_goes_first():
    assert name_markers(SUIT, {"LeftLeg": "LSHN"}).known["LeftLeg"] == "LSHN"


def test_joint_centres_are_places_on_the_body():
    names = name_markers(POSE2SIM)
    landmarks = marker_landmarks(load_body(), tuple(names.known.values()))
    assert landmarks.posedirs is None and len(landmarks) == len(POSE2SIM)
    assert placement_precision(load_body(), landmarks.names).shape == (len(POSE2SIM), 3, 3)


@pytest.mark.parametrize("system", SKELETONS)
def test_skeletons_of_other_programs_are_recognised(system):
    labels, some = SKELETONS[system]
    places = joint_centre_places(labels)
    assert set(places) == set(labels) and {label: places[label] for label in some} == some


@pytest.mark.parametrize("system", SYSTEMS)
def test_marker_sets_of_other_systems_are_no_skeletons_and_are_known(system):
    labels, no_place = SYSTEMS[system]
    assert not joint_centre_places(labels)
    assert set(name_markers(labels).known) == set(labels) - set(no_place)


def test_an_ending_that_all_share_is_no_part_of_the_names():
    names = name_markers(SYSTEMS["OpenCap"][0])
    assert names.affixes.suffix.lstrip("_") == "study" and names.virtual == ("RHJC_study", "LHJC_study")
    assert names.known["r_mknee_study"] == "RKNM" and names.known["L.ASIS_study"] == "LFWT"


def test_an_upper_body_with_a_nose_and_computed_joint_centres_alone_are_joints():
    arms = ("LShoulder", "LElbow", "LWrist", "RShoulder", "RElbow", "RWrist")
    assert not joint_centre_places((*arms, "C7"))
    assert joint_centre_places((*arms, "Nose", "Neck"))["LElbow"] == "~left_elbow"
    legs = ("LHJC", "LKJC", "LAJC", "RHJC", "RKJC", "RAJC")
    assert joint_centre_places(legs)["RKJC"] == "=right_knee"
    assert not joint_centre_places((*legs, "LASI", "RASI", "SACR", "LTOE", "RTOE"))
