"""Body model: kinematics, skinning, landmarks, and files of the SMPL family."""
