"""Files in and out: captures, calibrations, motions; converts to metres, seconds and Z up here and nowhere else."""
