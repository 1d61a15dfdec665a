"""What a sensor makes of a scene: which surface each pixel sees, and infrared and depth as real devices measure them."""
