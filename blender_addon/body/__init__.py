"""The body as a Blender character: posable armature, shape sliders, pose correctives, controls and asset."""
