"""Hostile input from a seed: files, formulas, libraries, results, records and commands."""
