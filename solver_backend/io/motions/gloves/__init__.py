"""Recordings of gloves."""
