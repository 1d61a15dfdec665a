"""Choose and read body files of the SMPL family without trusting them."""
