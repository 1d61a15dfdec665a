"""Review takes: frame ranges to review, confidence colours, and pinned poses."""
