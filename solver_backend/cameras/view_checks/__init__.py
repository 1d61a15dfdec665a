"""Whether the views of one person agree, and their repair: cameras turned, mirrored, exchanged, late; limbs swapped."""
