"""How each method finds the poses of a take, one file per recipe. ``fitters/pipeline.py`` lists them."""
