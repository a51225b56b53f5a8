"""Hostile input from a seed: files, formulas, libraries, results, records and commands as a stranger sends them."""
