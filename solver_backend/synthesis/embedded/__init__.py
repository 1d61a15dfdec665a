"""Create captures with ground truth from an authored motion, cameras on tripods and simulated detectors."""
