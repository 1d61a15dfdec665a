"""Body files of the SMPL family: the choice of one, read without trusting it."""
