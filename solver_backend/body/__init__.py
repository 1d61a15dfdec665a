"""Body model of the SMPL family: kinematics, skinning, landmarks and file readers."""
