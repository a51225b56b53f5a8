"""Compare what commands answer on the golden records with what is kept, or keep it anew.

python -m benchmarks.golden [--write] [--only WORDS] [--part fast|slow|benchmark]

Values may differ by a tenth of their errors, errors by 5 %; names and verdicts are equal, p-values on the
same side of their level. Measured records and files of laboratories are read beside the project, ../shared,
or beside the folder in SYSID_TRIB_DATA; without them these cases are left out.
"""

import argparse
import sys
import time

from benchmarks.golden.answers import answer, differences, keep, kept_answers
from benchmarks.golden.cases import CASES


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--write", action="store_true", help="keep the answers")
    parser.add_argument("--only", default="", help="part of the names")
    parser.add_argument("--part", choices=("fast", "slow", "benchmark"))
    asked = parser.parse_args()
    kept, wrong, seen = kept_answers(), 0, 0
    for case in CASES:
        if asked.only not in case.name or asked.part not in (None, case.part):
            continue
        if case.needs is not None and not case.needs.is_dir():
            print(f"{case.name}: left out, no {case.needs}")
            continue
        start = time.process_time()
        found, seen = answer(case), seen + 1
        if asked.write:
            keep({case.name: found})
            told = [str(found["words"].get("verdict") or found["words"].get("best") or found["words"])]
        elif case.name not in kept:
            told = ["not kept: --write"]
            wrong += 1
        else:
            told = differences(kept[case.name], found)
            wrong += bool(told)
        print(
            f"{case.name} ({time.process_time() - start:.1f} s): {'; '.join(told) or 'the same'}", flush=True
        )
    print(f"{seen} cases, {wrong} not the same")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
