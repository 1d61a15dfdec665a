"""What every part of the add-on agrees on: frames, time, names, colours; and how they stand in Blender."""
