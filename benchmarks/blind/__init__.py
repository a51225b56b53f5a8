"""Blind tests: hidden forces from an integrator of their own, named from a file alone."""
