"""Create captures with known ground truth from a list of described shots."""
