"""Compare a motion with its capture's ground truth, and with filtered triangulation."""
