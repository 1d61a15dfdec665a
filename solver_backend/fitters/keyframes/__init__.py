"""Solve all keyframes in a take at once, or one window after another (thesis 6.3.2)."""
