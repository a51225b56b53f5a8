"""python -m benchmarks.blind: development records, see confirmation.py."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from blind.confirmation import main

main("development")
