"""Body files of the SMPL family: which one is meant, read without trusting it."""
