"""Captures with known truth: authored motion, cameras on tripods, detectors with errors."""
