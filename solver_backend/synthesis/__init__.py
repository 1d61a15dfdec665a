"""Create captures with ground truth: the demo, simulated captures and studio data sets."""
