"""Label the points in an unlabelled cloud, and locate hidden markers.

``positions`` are (F, N, 3) in metres, Z up, NaN where missing. ``labels`` and ``trusted`` have one value per chain of
tracklets, (C,).
"""
