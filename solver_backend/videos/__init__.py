"""Convert videos to a capture. Pictures, sound and detectors need the extra ``capture``, imported on use."""
