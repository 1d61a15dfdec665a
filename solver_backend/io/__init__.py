"""Read and write captures, calibrations and motions. Only this package converts to metres, seconds and Z up."""
