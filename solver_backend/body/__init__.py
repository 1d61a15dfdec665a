"""Body model: kinematics, skinning, landmarks, anatomical rules, and files of the SMPL family."""
