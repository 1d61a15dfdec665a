"""Shared parts of every training: the loop, devices, logs, weight files, model cards."""
