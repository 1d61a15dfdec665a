"""Labels of systems as their own documents and example files write them, for tests of reading names."""

import re


def _both(labels: str) -> tuple[str, ...]:
    """Return labels of which ``?`` stands for either side's letter."""
    return tuple(
        name
        for label in labels.split()
        for name in ([label.replace("?", s) for s in "LR"] if "?" in label else [label])
    )


OPENCAP = _both(
    "r.ASIS_study L.ASIS_study r.PSIS_study L.PSIS_study r_knee_study L_knee_study r_mknee_study L_mknee_study "
    "r_ankle_study L_ankle_study r_mankle_study L_mankle_study r_toe_study L_toe_study r_5meta_study L_5meta_study "
    "r_calc_study L_calc_study r_sh1_study r_sh2_study L_sh1_study r_thigh1_study L_thigh1_study C7_study "
    "r_shoulder_study L_shoulder_study r_lelbow_study r_melbow_study L_lelbow_study L_melbow_study r_lwrist_study "
    "r_mwrist_study L_lwrist_study L_mwrist_study RHJC_study LHJC_study"
)
"""OpenCap's augmented markers, as its TRC files name them (Uhlrich et al., 2023)."""

SYSTEMS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "OpenCap": (OPENCAP, tuple(label for label in OPENCAP if re.search(r"sh\d|thigh\d|HJC", label))),
    "OpenSim gait2392": (
        _both(
            "Sternum ?.Acromium Top.Head ?.Bicep ?.Elbow ?.Wrist.Med ?.Wrist.Lat ?.Asis V.Sacral ?.Thigh.Upper "
            "?.Thigh.Front ?.Shank.Upper ?.Heel ?.Toe.Tip ?.Knee.Lat ?.Knee.Med ?.Ankle.Lat ?.Ankle.Med"
        ),
        _both("?.Thigh.Upper ?.Shank.Upper"),
    ),
    "IOR whole body": (
        _both("C7 T2 MAI SJN SXS ?AC ?ASIS ?PSIS ?GT ?LE ?ME ?HF ?TT ?LM ?MM ?CA ?FM ?SM ?VM ?HE ?US ?RS"),
        (),
    ),
    "Visual3D six degrees": (
        _both("?IC ?ASIS ?PSIS ?GT ?LK ?MK ?TH1 ?TH2 ?SK1 ?SK2 ?LA ?MA ?HEEL ?1MT ?5MT ?TOE"),
        _both("?TH1 ?TH2 ?SK1 ?SK2"),
    ),
    "Cleveland Clinic": (
        _both("?ASIS SACRUM ?THI1 ?THI2 ?LKNEE ?MKNEE ?LANKLE ?MANKLE ?HEEL ?TOE ?SHOULDER ?ELBOW ?WRIST"),
        _both("?THI1 ?THI2"),
    ),
    "Qualisys animation": (
        _both(
            "HeadL HeadR HeadTop HeadFront SpineTop SpineThoracic2 Chest BackL BackR ?ShoulderTop ?ElbowOut ?ElbowIn "
            "?WristOut ?WristIn ?HandOut ?HandIn Waist?Front Waist? Waist?Back ?KneeOut ?KneeIn ?AnkleOut ?HeelBack "
            "?ForefootOut ?Forefoot2 ?ForefootIn ?ToeTip"
        ),
        (),
    ),
    "Oxford foot": (
        _both("?ASI ?PSI SACR ?THI ?KNE ?HFB ?TUB ?SHN ?ANK ?MMA ?HEE ?D1M ?P1M ?D5M ?P5M ?TOE ?HLX"),
        _both("?P1M ?P5M"),
    ),
    "added medial markers": (_both("?SHO ?ELB ?ELBM ?WRA ?WRB ?ASI ?PSI ?KNE ?KNEM ?ANK ?ANKM ?HEE ?TOE"), ()),
}
"""Labels of each system, and those of them that name no place on the body."""

SKELETONS: dict[str, tuple[tuple[str, ...], dict[str, str]]] = {
    "Xsens segments": (
        _both("Pelvis L5 L3 T12 T8 Neck Head")
        + tuple(
            side + part
            for side in ("Left", "Right")
            for part in _both("Shoulder UpperArm ForeArm Hand UpperLeg LowerLeg Foot Toe")
        ),
        {"LeftUpperArm": "=left_shoulder", "RightLowerLeg": "=right_knee", "LeftFoot": "=left_ankle", "T8": ""},
    ),
    "Kinect": (
        ("SpineBase", "SpineMid", "SpineShoulder", "Neck", "Head")
        + tuple(
            part + side
            for side in ("Left", "Right")
            for part in _both("Shoulder Elbow Wrist Hand HandTip Thumb Hip Knee Ankle Foot")
        ),
        {"HipLeft": "=left_hip", "KneeRight": "=right_knee", "FootLeft": "=left_foot", "SpineBase": "=pelvis"},
    ),
    "Human3.6M": (
        _both("Hip Spine Thorax Neck Head ?Hip ?Knee ?Foot ?Shoulder ?Elbow ?Wrist"),
        {"LFoot": "=left_ankle", "RKnee": "=right_knee", "Hip": "=pelvis"},
    ),
    "3ds Max Biped": (
        tuple(
            f"Bip01 {part}"
            for part in (
                *_both("Pelvis Spine Spine1 Neck Head"),
                *(f"{s} {p}" for s in "LR" for p in _both("Clavicle UpperArm Forearm Hand Finger0 Finger01")),
                *(f"{s} {p}" for s in "LR" for p in _both("Thigh Calf Foot Toe0")),
            )
        ),
        {"Bip01 L Thigh": "=left_hip", "Bip01 R Calf": "=right_knee", "Bip01 L Finger01": ""},
    ),
    "Mixamo with fingers": (
        tuple(
            f"mixamorig_{part}"
            for part in (
                *_both("Hips Spine Spine1 Spine2 Neck Head HeadTop_End"),
                *(
                    side + p
                    for side in ("Left", "Right")
                    for p in (
                        *_both("Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase Toe_End"),
                        *(f"Hand{f}{k}" for f in _both("Thumb Index Middle Ring Pinky") for k in range(1, 5)),
                    )
                ),
            )
        ),
        {"mixamorig_LeftUpLeg": "=left_hip", "mixamorig_RightHandRing2": "", "mixamorig_LeftHand": "=left_wrist"},
    ),
    "a shared ending": (
        tuple(
            f"{name}_pos"
            for name in (
                *("Hips", "Spine", "Neck", "Head"),
                *(s + p for s in ("Left", "Right") for p in _both("UpLeg Leg Foot Arm ForeArm Hand")),
            )
        ),
        {"LeftUpLeg_pos": "=left_hip", "RightForeArm_pos": "=right_elbow"},
    ),
}
"""Joint centres of each system, and some of their places."""
