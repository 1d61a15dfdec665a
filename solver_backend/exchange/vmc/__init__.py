"""Send and receive live motion with the Virtual Motion Capture protocol."""
