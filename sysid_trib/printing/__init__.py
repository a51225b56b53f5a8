"""Results in words, tables and plain data."""
