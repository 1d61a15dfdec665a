"""Find the poses of a take with each method, one file per recipe. ``fitters/pipeline.py`` lists them."""
