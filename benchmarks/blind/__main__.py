"""python -m benchmarks.blind: see study.py."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from blind.study import main

main()
