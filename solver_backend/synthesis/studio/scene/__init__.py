"""What stands before the cameras: the person in clothes, furniture, the room, and which surface each pixel sees."""
