"""Generate the neutral body and its hands from the committed numbers.

Arrays always have these shapes: ``vertices`` (V, 3) and ``joints`` (24, 3) in metres, ``faces`` (T, 3), ``weights`` (V,
24), and ``mirror`` (V,), which is the index of each vertex's mirror image.
"""
