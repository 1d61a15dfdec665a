"""Format writers, and checks around Blender's own exporters."""
