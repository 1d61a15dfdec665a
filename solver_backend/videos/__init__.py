"""Convert videos to a capture (extra ``capture``)."""
