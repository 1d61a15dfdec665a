"""Parts that all trainings share: the loop, devices, logs, weight files and model cards."""
