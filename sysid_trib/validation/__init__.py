"""Is it true: cross-check, homogeneity of runs, hold-out, comparison of methods."""
