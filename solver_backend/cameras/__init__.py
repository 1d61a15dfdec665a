"""Camera models: lens distortion, projection with derivatives, robust triangulation."""
