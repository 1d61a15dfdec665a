"""What a fit solves from: points, their covariance and a data term; built from views or from markers."""
