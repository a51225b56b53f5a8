"""Methods of others beside ours on the same records: python -m benchmarks.arena."""
