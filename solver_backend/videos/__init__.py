"""Convert videos to a capture. Images, sound and detectors need the extra ``capture``, which is imported on use."""
