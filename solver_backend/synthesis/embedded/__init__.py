"""Create captures with ground truth: authored motion, cameras on tripods, simulated detectors."""
