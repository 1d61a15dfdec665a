"""Benchmarks with a committed baseline: ``python3 dev.py bench [NAME]``."""
