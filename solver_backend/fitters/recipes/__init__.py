"""Solve the poses in a take, with one module per method. ``fitters/pipeline.py`` lists the methods."""
