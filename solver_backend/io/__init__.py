"""Read and write captures, calibrations and motions. Convert their units and axes."""
