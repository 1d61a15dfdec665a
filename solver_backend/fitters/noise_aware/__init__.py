"""Body fits to 3D landmarks of unequal reliability, frame by frame, as published (thesis chapter 5)."""
