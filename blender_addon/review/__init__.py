"""Where to look and what to do about it: doubtful ranges, painted bones, pinned poses."""
