"""Hands beside a solved body: each hand's wrist and fingers over the take, from keypoints in views or from markers."""
