"""One camera: what it measures of a person, and what it leaves open."""
