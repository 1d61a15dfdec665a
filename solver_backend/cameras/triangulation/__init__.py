"""Points from views: linear candidates, robust refinement, the detector's noise."""
