"""Calibrations written as other programs read them."""
