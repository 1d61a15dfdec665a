"""The studio's colour pictures: shots that the backend set up, lit and rendered by Blender's own engines."""
