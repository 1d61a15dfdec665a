"""Frames, time and names: the solver's conventions in Blender's; no bpy."""
