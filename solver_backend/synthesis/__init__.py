"""Create captures with ground truth: the demo, simulated ones, and studio data sets."""
