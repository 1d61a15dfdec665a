"""Captures with known truth: authored motion, cameras on tripods, detectors that err."""
