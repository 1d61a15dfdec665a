"""Choose and safely read body files of the SMPL family."""
