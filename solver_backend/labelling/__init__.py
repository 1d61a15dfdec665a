"""Label the points of an unlabelled cloud, and locate hidden markers.

``positions`` are (F, N, 3) metres, Z up, NaN where missing. ``labels`` and ``trusted`` are (C,) per chain of tracklets.
"""
