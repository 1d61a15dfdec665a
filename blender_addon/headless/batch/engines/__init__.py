"""Engines of a batch: this process, processes of this machine, or the workers of a Dask cluster."""
