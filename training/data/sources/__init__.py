"""Readers for the recordings in the corpus."""
