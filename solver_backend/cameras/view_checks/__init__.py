"""Do the views of one person agree, and their repair: cameras rotated, mirrored, exchanged or late, limbs swapped."""
