"""Write each notebook NAME.ipynb, without outputs, from its text NAME.py: python notebooks/pair.py."""

from pathlib import Path

import jupytext
import nbformat

HERE = Path(__file__).parent
KERNEL = {"name": "python3", "display_name": "Python 3", "language": "python"}


def scripts() -> list[Path]:
    """Texts of the notebooks, 01_*.py to 99_*.py, in reading order."""
    return sorted(HERE.glob("[0-9][0-9]_*.py"))


def notebook_text(script: Path) -> str:
    """The notebook that belongs to a text; the same text gives the same notebook."""
    notebook = jupytext.read(script)
    notebook.metadata = nbformat.from_dict({"kernelspec": KERNEL})
    for number, cell in enumerate(notebook.cells):
        # Random identities would change with every writing.
        cell.id = f"cell-{number}"
        # Lines that a function is set off by in the text.
        cell.source = cell.source.strip("\n")
    nbformat.validate(notebook)
    return nbformat.writes(notebook) + "\n"


def main() -> None:
    for script in scripts():
        beside = script.with_suffix(".part")
        beside.write_text(notebook_text(script), encoding="utf-8")
        beside.replace(script.with_suffix(".ipynb"))


if __name__ == "__main__":
    main()
