"""The review of takes: ranges to review, colours of confidence, pinned poses."""
