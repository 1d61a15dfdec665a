"""Names for the points of an unlabelled cloud, and places of hidden markers.

``positions`` are (F, N, 3) metres, Z up, NaN where missing. ``labels`` and ``trusted`` are (C,), by chain of tracklets.
"""
