"""One module a format, and what guards Blender's own exporters."""
