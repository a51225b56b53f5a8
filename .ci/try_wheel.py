"""Install a wheel into a clean environment, and use it from a folder without the sources.

python .ci/try_wheel.py dist/NAME.whl [--constraints FILE]
"""

import argparse
import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Run with the Python of the clean environment; the arguments are the libraries that the wheel must contain.
LOAD_LIBRARIES = """
import sys
from pathlib import Path

import sysid_trib
from sysid_trib.forces.systems import load_system

package = Path(sysid_trib.__file__).parent
if Path(sys.prefix) not in package.parents:
    sys.exit(f"The package was imported from {package}, not from the wheel.")
shipped = {file.stem for file in (package / "libraries").glob("*.toml")}
if shipped != set(sys.argv[1:]):
    sys.exit(f"The wheel contains the libraries {sorted(shipped)}, the project has {sys.argv[1:]}.")
# The file of systems is in the same folder, but is not a library.
for name in sorted(shipped - {"systems"}):
    sysid_trib.load_library(name)
load_system("pendulum")
sysid_trib.datasets.load("certified/dry_1e-3")
"""
COMMANDS = (
    ("--help",),
    ("identify", "-o", "result.nc"),
    ("report", "result.nc", "-o", "report.html"),
)


def main() -> None:
    """Install the wheel, load its libraries, and run commands."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--constraints", type=Path, help="versions of the dependencies, for pip")
    given = parser.parse_args()
    limits = ["--constraint", str(given.constraints.resolve())] if given.constraints else []
    with tempfile.TemporaryDirectory() as scratch:
        environment = Path(scratch) / "venv"
        venv.create(environment, with_pip=True)
        programs = environment / ("Scripts" if os.name == "nt" else "bin")

        def run(program: str, *words: str) -> None:
            subprocess.run([programs / program, *words], cwd=scratch, check=True)

        print(f"Wheel check: installing {given.wheel.name}", *limits, flush=True)
        run(
            "python",
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            *limits,
            str(given.wheel.resolve()),
        )
        run("python", "-m", "pip", "--disable-pip-version-check", "list")
        run(
            "python", "-c", LOAD_LIBRARIES, *sorted(file.stem for file in (ROOT / "libraries").glob("*.toml"))
        )
        for command in COMMANDS:
            print("Wheel check: sysid-trib", *command, flush=True)
            run("sysid-trib", *command)
        run("python", "-m", "sysid_trib", "--version")
    print("Wheel check: passed")


if __name__ == "__main__":
    sys.exit(main())
