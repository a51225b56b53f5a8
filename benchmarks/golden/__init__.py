"""Golden records: what commands answer on many records, kept as compact JSON in tests/golden."""
