"""Files in and out: captures, calibrations and motions. The only place that converts to metres, seconds and Z up."""
