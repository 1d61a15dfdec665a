"""Read and write captures, calibrations and motions, with units and axes converted."""
