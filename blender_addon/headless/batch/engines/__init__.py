"""Engines of a batch: this process, processes on this machine, or the workers of a Dask cluster."""
