"""Benchmarks; `python -m benchmarks --help` names them."""

import os
import sys
from pathlib import Path

# Generators of records and known truths that the tests have as well.
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

# Measured records, which are no part of the repository.
DATA = Path(os.environ.get("SYSID_TRIB_DATA", Path(__file__).parents[2] / "shared" / "data"))
