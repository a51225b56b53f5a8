"""The one schema of results: dims, units, provenance, files, change of reference."""
