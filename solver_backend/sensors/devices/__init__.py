"""Sensors behind one interface: recorded folders, the studio's renderings, devices that are plugged in."""
