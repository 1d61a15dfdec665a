"""Make captures with known truth: the embedded demo, simulated detections and markers, and the studio's data sets."""
