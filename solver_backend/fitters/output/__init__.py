"""From solved poses to a Motion, and the frames that deserve a look."""
