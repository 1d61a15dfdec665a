"""Choose body files of the SMPL family, and read them without running code."""
