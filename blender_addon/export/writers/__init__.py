"""Writers of the formats, and guards of Blender's own exporters."""
