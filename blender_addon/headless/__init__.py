"""Solve, bake, export and render without Blender's window, also for a folder of captures."""
