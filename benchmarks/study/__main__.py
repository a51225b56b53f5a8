"""One study of noises and runs, by what is asked of them.

python -m benchmarks.study NAME [--seeds N] [--method NAME] [--only TEXT] [--out FILE] ...

precision     errors over the Cramér-Rao bound, of two runs together too; selection, cross-check
classical     classical methods: calibration on decays of their own model, bias where they neglect forces
pushed        coverage and errors where a random force pushes the motion, false ones where nothing does
cost          what an estimated random force costs where nothing pushes
verdicts      random forces and forces that are left out, told apart
agreement     false disagreements of pairs of runs that are pushed
bands         coverage of predictions 1, 3 and 10 periods ahead; --measured: measured records, and innovations
spread        intervals of what varies between runs and laboratories
rigs          two runs of rigs that lack an effect: differences over total errors
pairs         pairs of equal and of unequal samples, the model complete and not
profile       profile intervals of dahl.s, stribeck.s, lambda at its bound, beside errors
curve_bands   simultaneous bands of a model's curves
posterior     posteriors beside random-walk Metropolis, three records; --seeds: its steps

With --out each record is a line of JSON, and what the file has already is not done again.
"""

import argparse
from importlib import import_module
from pathlib import Path

# Usual number of seeds of each study.
STUDIES = {"precision": 400, "classical": 60, "pushed": 40, "cost": 2000, "verdicts": 20, "agreement": 1000}
STUDIES |= {"bands": 50, "spread": 2000, "rigs": 200, "pairs": 500, "profile": 400, "curve_bands": 400}
STUDIES |= {"posterior": 30_000}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--seeds", type=int, help="records of a kind (at most, for precision)")
    parser.add_argument("--first", type=int, default=0, help="first seed of verdicts and rigs")
    parser.add_argument(
        "--method", default="", help="direct, trajectory, averaging, or one of them with -off"
    )
    parser.add_argument("--only", default="", help="part of the titles of what is done")
    parser.add_argument("--out", type=Path, help="file of rows that is gone on with")
    parser.add_argument("--noise", choices=("white", "AR(0.8)"), default="white", help="of verdicts")
    parser.add_argument("--left-out", action="store_true", help="verdicts: forces that are left out alone")
    parser.add_argument("--unlike", type=float, default=1.0, help="agreement: density of the second run")
    parser.add_argument("--measured", action="store_true", help="bands: the measured records")
    parser.add_argument("--also", default="", metavar="SYMBOLS", help="bands --measured: further effects")
    parser.add_argument(
        "--across", action="store_true", help="bands --measured: what goes with the swing across"
    )
    parser.add_argument("--identified", type=int, default=0, help="spread: round-robins of records")
    parser.add_argument("--no-response", action="store_true", help="curve_bands: no forced response")
    asked = parser.parse_args()
    asked.seeds = STUDIES[asked.study] if asked.seeds is None else asked.seeds
    import_module(f"benchmarks.study.{asked.study}").main(asked)


if __name__ == "__main__":
    main()
