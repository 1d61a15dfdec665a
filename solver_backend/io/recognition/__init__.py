"""Recognise facts that files do not state: joint sets, frame numbers, units and up axes."""
