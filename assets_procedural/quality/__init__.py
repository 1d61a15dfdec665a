"""Measurements and pictures of a body file."""
