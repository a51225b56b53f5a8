#!/usr/bin/env bash
# Build sdist and, from it, the wheel; install the wheel into a clean environment; use it from / .
set -euo pipefail
cd "$(dirname "$0")/.."
unset PYTHONPATH
root=$PWD
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

echo "Wheel check: building sdist and wheel ..."
"$root/.venv/bin/python" -m build --outdir "$scratch/dist" . >"$scratch/log" 2>&1 || { cat "$scratch/log"; exit 1; }
echo "Wheel check: installing the wheel into a clean environment ..."
"$root/.venv/bin/python" -m venv "$scratch/venv"
"$scratch/venv/bin/python" -m pip install --quiet --disable-pip-version-check "$scratch"/dist/*.whl

cd /
"$scratch/venv/bin/python" - "$root"/libraries/*.toml <<'PYTHON'
import sys
from pathlib import Path

import sysid_trib

shipped = {file.stem for file in (Path(sysid_trib.__file__).parent / "libraries").glob("*.toml")}
expected = {Path(file).stem for file in sys.argv[1:]}
if shipped != expected:
    sys.exit(f"Wheel check: the wheel ships {sorted(shipped)}, the project has {sorted(expected)}.")
from sysid_trib.forces.systems import load_system

# Systems stand beside the libraries and are none.
for name in sorted(shipped - {"systems"}):
    sysid_trib.load_library(name)
    print(f"Wheel check: loaded library {name}")
load_system("pendulum")
sysid_trib.datasets.load("certified/dry_1e-3")
PYTHON
"$scratch/venv/bin/sysid-trib" --help >/dev/null
"$scratch/venv/bin/python" -m sysid_trib --help >/dev/null
"$scratch/venv/bin/sysid-trib" identify
echo "Wheel check: passed"
