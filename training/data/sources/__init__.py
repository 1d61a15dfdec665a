"""Readers for the corpus's recordings."""
