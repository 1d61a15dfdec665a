"""Create the demo captures from an authored motion, cameras on tripods and simulated detectors."""
