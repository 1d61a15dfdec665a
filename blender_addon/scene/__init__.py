"""What a capture looks like in Blender: cameras, footage, detections, floor; and the bake as a pipeline of verbs."""
