"""Read and write captures, calibrations and motions, and convert their units and axes."""
