"""Convert videos to a capture (needs the ``capture`` extra)."""
