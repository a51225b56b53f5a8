"""Rows: a record as equations about its path, the noise of both kinds in them, and fits of forces to them."""
