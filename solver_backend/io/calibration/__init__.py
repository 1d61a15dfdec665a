"""Camera calibrations of other tools, in metres with Z up."""
