"""Parts of a body that nothing informs: laid at rest, with the spread that people show.

``offsets`` are (L, 3) metres of the landmarks in the rest frame, and ``located`` (F, L) says which are known.
"""
