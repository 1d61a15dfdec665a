"""Estimate poses live from markers, camera views and other sources."""
