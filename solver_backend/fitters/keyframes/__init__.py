"""Solve all keyframes of a take at once, or window after window (thesis 6.3.2)."""
