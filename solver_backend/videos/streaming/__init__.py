"""Cameras while they film: pictures as they come, detected, brought together as moments, and recorded."""
