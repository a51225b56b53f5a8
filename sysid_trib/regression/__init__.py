"""Regression of Eq. 1 in weak form."""
