"""Turn videos into a capture: synchronise, detect people and calibrate (needs the ``capture`` extra)."""
