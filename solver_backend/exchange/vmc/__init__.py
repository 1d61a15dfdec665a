"""Motion to and from other programs while it happens: the Virtual Motion Capture protocol over Open Sound Control."""
