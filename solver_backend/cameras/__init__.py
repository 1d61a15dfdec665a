"""Model cameras: lens distortion, projection with derivatives, and robust triangulation."""
