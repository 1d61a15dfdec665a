"""Read recordings of optical markers: C3D, TRC, and the tables of programs."""
