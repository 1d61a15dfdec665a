"""Measure a body file, and draw pictures of it."""
