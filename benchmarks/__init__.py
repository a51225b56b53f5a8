"""Benchmarks; `python -m benchmarks --help` names them."""

import sys
from pathlib import Path

# Generators of records and known truths that the tests have as well.
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
