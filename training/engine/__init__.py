"""Shared parts of all trainings: the loop, devices, logs, weight files and model cards."""
