"""Read lab files that are drawn anew, and count those that are read as they should be.

    python -m benchmarks.contact [--seed N] [--draws N] [--only WORD] [--keep FOLDER]

Each kind of file is drawn `--draws` times: numbers, spellings and layouts differ. What is right of it is
known before it is read: quantity, unit, number of decays, period (1 %), rate of decay (12 %), first amplitude
(12 %); or a word of the cause for which it is to be refused. A file is read in about 0.1 s.
"""

import argparse
import re
import tempfile
from collections import Counter
from pathlib import Path

from benchmarks.contact.kinds import KINDS, drawn


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--draws", type=int, default=3)
    options.add_argument("--only", default="")
    options.add_argument("--keep", type=Path)
    given = options.parse_args()
    names, wrong = [name for name in KINDS if re.search(given.only, name)], Counter()
    with tempfile.TemporaryDirectory() as folder:
        out = given.keep or Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        for name in names:
            for number in range(given.draws):
                file, said = drawn(name, out, given.seed, number)
                if said:
                    wrong[name] += 1
                    print(f"{file}: {said}", flush=True)
    count, kinds = given.draws * len(names), f"{len(names) - len(wrong)} of {len(names)} kinds in every draw"
    print(f"seed {given.seed}: {count - wrong.total()} of {count} files as they should be; {kinds}")


if __name__ == "__main__":
    main()
