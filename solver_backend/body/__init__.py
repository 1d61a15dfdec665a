"""The body model: kinematics, skinning, landmarks, anatomical rules, files of the SMPL family."""
