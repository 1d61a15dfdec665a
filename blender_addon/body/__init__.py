"""The body as a Blender character: armature, sliders, correctives and controls."""
