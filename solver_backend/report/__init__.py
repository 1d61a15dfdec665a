"""One page about a solve: its quality, the frames to check, and its settings. It needs no network."""
