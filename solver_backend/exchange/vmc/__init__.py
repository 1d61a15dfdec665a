"""Send and receive live motion: the Virtual Motion Capture protocol over Open Sound Control."""
