"""From cameras on tripods to a capture: calibrate, synchronise, detect. Needs the extra ``capture``."""
