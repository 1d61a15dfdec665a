"""Create data sets of simulated captures with ground truth from a list of described shots."""
