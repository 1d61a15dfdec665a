"""Labels of joint centres as an inertial suit and Pose2Sim write them."""

SUIT = (
    "Hips", "RightThigh", "RightLeg", "RightFoot", "RightToe", "RightToeEnd", "LeftThigh", "LeftLeg", "LeftFoot",
    "LeftToe", "LeftToeEnd", "SpineLow", "SpineMid", "Chest", "RightShoulder", "RightArm", "RightForearm", "RightHand",
    "LeftShoulder", "LeftArm", "LeftForearm", "LeftHand", "Neck", "Head", "HeadEnd",
)  # fmt: skip
POSE2SIM = (
    "CHip", "RHip", "RKnee", "RAnkle", "RBigToe", "RSmallToe", "RHeel", "LHip", "LKnee", "LAnkle", "LBigToe",
    "LSmallToe", "LHeel", "Neck", "Head", "Nose", "RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist",
)  # fmt: skip
