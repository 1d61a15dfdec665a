"""Estimate poses live from points, views and other sources."""
