"""Solve all keyframes in a take at once, or one window of frames after another (thesis 6.3.2)."""
