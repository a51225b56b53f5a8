"""What the settings of `discover` decide: each halved and doubled, on development records.

python -m benchmarks.blind.settings [--numbers N ...] [--only NAME ...] [--salt TEXT]

Records are drawn as those of the confirmation set, from a salt of their own: constants may be chosen by them.
Of each change it counts records with another verdict, with other names, with another credible set, and those
where the truth, alone, is right that was not before, and the other way round.
"""

import argparse
import warnings
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

from benchmarks.blind.cases import Drawn, draw_case
from benchmarks.blind.confirmation import look
from sysid_trib.likelihood.settings import DEFAULTS, Settings

SALT = "pilot"
# Of two or three thousand samples and fewer: seconds each.
NUMBERS = (1, 10, 16, 23, 28, 34, 37, 44)


def changed() -> Iterator[tuple[str, str, Settings]]:
    """Each setting at half and at twice its value; of a probability its complement, of a seed another."""
    for field in fields(Settings):
        value = getattr(DEFAULTS, field.name)
        for factor in (0.5, 2.0):
            other: float = value * factor
            if field.name == "credible":
                other = 1.0 - (1.0 - value) * factor
            elif field.name == "seed":
                other = int(1 / factor)
            elif isinstance(value, int):
                other = max(1, round(other))
            yield field.name, f"{other:.4g}", replace(DEFAULTS, **{field.name: other})


def outcome(case: Drawn, settings: Settings) -> dict[str, Any]:
    """Verdict, names and sets of a record, and whether what is hidden, and nothing else, is in a set."""
    found = look(case, settings)
    sets = {step["symbol"]: frozenset(step["ties"]) for step in found["steps"]}
    hidden = [effect.symbol for effect in case.hidden if effect.symbol not in case.left_out]
    right = len(sets) == len(hidden) and all(any(s in tied for tied in sets.values()) for s in hidden)
    return {"verdict": found["verdict"], "names": {*sets}, "sets": sets, "right": right}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--numbers", type=int, nargs="+", default=list(NUMBERS), metavar="N")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="settings that are changed")
    parser.add_argument("--salt", default=SALT, metavar="TEXT")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    cases = [draw_case(options.salt, number) for number in options.numbers]
    before = [outcome(case, DEFAULTS) for case in cases]
    print(f"{len(cases)} records, right as they are: {sum(one['right'] for one in before)}\n")
    print("| setting | changed to | verdict | names | sets | right no more | right now |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, value, settings in changed():
        if options.only and name not in options.only:
            continue
        after = [outcome(case, settings) for case in cases]
        pairs = list(zip(before, after, strict=True))
        moved = [sum(old[key] != new[key] for old, new in pairs) for key in ("verdict", "names", "sets")]
        lost = sum(old["right"] and not new["right"] for old, new in pairs)
        won = sum(new["right"] and not old["right"] for old, new in pairs)
        print(f"| `{name}` | {value} | {' | '.join(map(str, [*moved, lost, won]))} |", flush=True)


if __name__ == "__main__":
    main()
