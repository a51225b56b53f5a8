"""Rows: a record as equations about its path, their two noises, and fits of forces to them."""
