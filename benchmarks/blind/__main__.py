"""python -m benchmarks.blind: development records, see confirmation.py."""

from benchmarks.blind.confirmation import main

main("development")
