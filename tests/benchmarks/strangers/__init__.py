"""Recordings in files of other programs and with typical user mistakes, one or two at once."""
