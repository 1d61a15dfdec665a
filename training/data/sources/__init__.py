"""Readers of the corpus's recordings."""
