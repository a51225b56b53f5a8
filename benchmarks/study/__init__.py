"""Studies of noises and runs over many seeds; `python -m benchmarks.study --help` names them."""

import sys
from pathlib import Path

# Generators of records and known truths that the tests have as well.
sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
