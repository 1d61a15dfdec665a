"""From solver files to Blender objects: armature, mesh, action, cameras, detections and floor."""
