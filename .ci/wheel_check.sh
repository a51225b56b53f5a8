#!/usr/bin/env bash
# Build sdist and, from it, the wheel; use the wheel as a stranger does, with the newest and with the lowest dependencies.
set -euo pipefail
cd "$(dirname "$0")/.."
unset PYTHONPATH
python=${PYTHON:-$PWD/.venv/bin/python}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

echo "Wheel check: building sdist and wheel ..."
"$python" -m build --outdir "$scratch/dist" . >"$scratch/log" 2>&1 || { cat "$scratch/log"; exit 1; }
"$python" .ci/lowest.py >"$scratch/lowest.txt"
"$python" .ci/try_wheel.py "$scratch"/dist/*.whl
"$python" .ci/try_wheel.py "$scratch"/dist/*.whl --constraints "$scratch/lowest.txt"
