"""Layouts of states and poses of the body that ships with the solver, as SPoser decodes them."""

from solver_backend.body.state_layout import RESIDUAL, PoseLayout, StateLayout

POSE = PoseLayout(21)
WHOLE = StateLayout.of(30, 21)
"""Of a key whose joints may leave the manifold: 99."""
ON_MANIFOLD = WHOLE.without(RESIDUAL)  # 36.
LAYOUTS = {False: ON_MANIFOLD, True: WHOLE}  # By whether the residual rotations are free.
