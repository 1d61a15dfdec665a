"""Make captures with ground truth: the embedded demo, simulated detections and markers, and the studio's data sets."""
