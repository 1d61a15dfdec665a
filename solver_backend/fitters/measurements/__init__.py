"""Prepare the input of a fit from views or markers: points, their covariance and a data term."""
