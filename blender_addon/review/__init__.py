"""Where to look and what to do about it: confidence, doubtful stretches, pinned poses."""
