"""Create captures with ground truth: the demo, simulations and rendered data sets."""
