"""What every training shares: the loop, devices, logs, weight files, model cards."""
