"""What sensors make of a scene: the surface each pixel sees, and infrared and depth as devices measure them."""
