"""Execute the notebooks, copies with outputs to notebooks/executed: python notebooks/run.py [NAME ...].

SYSID_TRIB_QUICK=1 shrinks what takes long. Exit status 1 if a notebook fails, 2 for one that does not exist.
"""

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError
from rich.progress import Progress
from rich.text import Text
from traitlets.config import Config

HERE = Path(__file__).parent
EXECUTED = HERE / "executed"
# Measured records beside the project; without them the notebooks download theirs.
RECORDS = HERE.parents[1] / "shared" / "data"
SECONDS_PER_CELL = 600


def execute(path: Path, progress: Progress) -> str:
    """Execute a notebook and keep the copy, also of one that fails; '' or where and why it failed."""
    notebook = nbformat.read(path, as_version=4)
    count = sum(cell.cell_type == "code" for cell in notebook.cells)
    bar = progress.add_task(path.stem, total=count)
    started: list[int] = []

    def begin(cell: nbformat.NotebookNode, cell_index: int) -> None:
        started.append(cell_index)
        progress.advance(bar)

    since, failure = monotonic(), ""
    try:
        # Sockets in files of its own: no other kernel can take them, as it can a port.
        with TemporaryDirectory() as folder:
            sockets = {"transport": "ipc", "connection_file": f"{folder}/kernel.json"}
            NotebookClient(
                notebook,
                timeout=SECONDS_PER_CELL,
                startup_timeout=SECONDS_PER_CELL,
                config=Config({"KernelManager": sockets}),
                resources={"metadata": {"path": str(HERE)}},
                on_cell_execute=begin,
            ).execute()
    except (CellExecutionError, CellTimeoutError, RuntimeError) as error:
        at = f"{path.name}, code cell {len(started)} of {count}"
        failure = f"{at}: {Text.from_ansi(str(error)).plain}"
    EXECUTED.mkdir(exist_ok=True)
    beside = EXECUTED / f"{path.stem}.part"
    nbformat.write(notebook, beside)
    beside.replace(EXECUTED / path.name)
    progress.remove_task(bar)
    progress.print(f"{path.stem}: {'failed' if failure else 'done'} after {monotonic() - since:.0f} s")
    return failure


def main(names: list[str]) -> int:
    notebooks = {path.stem: path for path in sorted(HERE.glob("[0-9][0-9]_*.ipynb"))}
    if unknown := [name for name in names if name not in notebooks]:
        print(f"There is no notebook {unknown[0]}, but {', '.join(notebooks)}.", file=sys.stderr)
        return 2
    if RECORDS.is_dir():
        os.environ.setdefault("SYSID_TRIB_DATA", str(RECORDS))
    # A kernel a core: threads of their own would only wait for each other.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with Progress() as progress, ThreadPoolExecutor(os.cpu_count()) as workers:
        found = list(workers.map(lambda name: execute(notebooks[name], progress), names or notebooks))
    failures = [failure for failure in found if failure]
    if failures:
        print("", *failures, sep="\n", file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
