"""Camera models: lens distortion, projection with derivatives, rays, robust triangulation."""
