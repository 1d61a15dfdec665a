"""The studio: captures with known truth, from a description of shots to infrared, depth, masks and a scored solve."""
