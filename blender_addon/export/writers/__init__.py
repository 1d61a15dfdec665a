"""Writers for each format, and checks around Blender's own exporters."""
