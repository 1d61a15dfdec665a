"""Create captures with known ground truth from a description of shots."""
