"""The chain while it happens: a process a sensor, one that fuses, and nothing that lags."""
