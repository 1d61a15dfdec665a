"""Read camera calibrations of other programs. The results are in metres with Z up."""
