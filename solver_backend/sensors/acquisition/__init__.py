"""From one frame of infrared and depth to markers in space, each with a covariance. NumPy alone."""
