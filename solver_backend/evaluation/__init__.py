"""Compare a motion with the ground truth of its capture, and with a plain filter."""
