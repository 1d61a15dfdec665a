"""Read camera calibrations of other programs. Results are in metres with Z up."""
