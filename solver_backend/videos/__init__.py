"""Turn videos into a capture. Pictures, sound and detectors need the extra ``capture``, imported where it is used."""
