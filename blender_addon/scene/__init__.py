"""Captures and takes in Blender: cameras, footage, detections, floor, and the baked body."""
