"""Label the points of unlabelled marker clouds, and estimate hidden markers.

``positions`` are (F, N, 3) in metres, Z up, NaN where missing. ``labels`` and ``trusted`` have one value per chain of
tracklets, (C,).
"""
