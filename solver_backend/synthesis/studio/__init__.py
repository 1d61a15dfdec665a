"""Create captures with known ground truth, from a description of shots to infrared, depth, masks and a scored solve."""
