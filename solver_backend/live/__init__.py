"""Estimate poses from live points, views and other sources."""
