"""What the command line is called inside Blender; alone here, as registering must load nothing else."""

COMMAND = "manifold_mocap"
"""``blender --command manifold_mocap``."""
