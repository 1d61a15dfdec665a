"""Create captures with ground truth: the embedded demo, simulated detections and markers, and studio data sets."""
