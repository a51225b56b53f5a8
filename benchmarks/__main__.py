"""One benchmark, by what is asked of it.

python -m benchmarks NAME [--seeds N] [--only TEXT] [--method NAME] [--out FILE] ...

Studies over seeds:
precision     errors over the Cramér-Rao bound, of two runs together too; selection, cross-check
classical     classical methods: calibration on decays of their own model, bias where they neglect forces
pushed        coverage and errors where a random force pushes the motion, false ones where nothing does
verdicts      random forces and forces that are left out, told apart
agreement     false disagreements of pairs of runs that are pushed
differences   cross-checks of right methods: false disagreements, errors of the difference
bands         coverage of predictions 1, 3 and 10 periods ahead; --measured: measured records, and innovations
spread        intervals of what varies between runs and laboratories
rigs          two runs of rigs that lack an effect: differences over total errors
pairs         pairs of equal and of unequal samples, the model complete and not
profile       profile intervals of dahl.s, stribeck.s, lambda at its bound, beside errors
curve_bands   simultaneous bands of a model's curves
backbone      bands of frequency and damping against amplitude, twelve kinds of forces
modes         several modes in one decay: frequencies, and bands of one of them or of two that are close
laws          bands and errors of friction and restoring force as curves, five kinds of laws
plan          discover, plan, run, discover again: whether what is stated comes true
loops         runs until one right name, with planned releases and with drawn ones

Measured and driven records: measured, answer, random_force_kinds, driven, servo. On the same ones: arena.
The official tests of nonlinearbenchmark.org: public.
On the certified decays: certified (--method, --only a decay, --seeds of the noise, --answers FILE).
Time, memory, kills: simulator, timing, cost, campaign (--only a part of each).

With --out each record is a line of JSON, and what the file has already is not done again.
"""

import argparse
from importlib import import_module
from pathlib import Path

# Where each stands, and its usual number of seeds, records or loops, if it has one.
NAMES = {
    "precision": ("study.coefficients", 400),
    "classical": ("study.coefficients", 60),
    "pushed": ("study.coefficients", 40),
    "verdicts": ("study.noises", 20),
    "bands": ("study.noises", 50),
    "agreement": ("study.runs", 1000),
    "differences": ("differences", 50),
    "pairs": ("study.runs", 500),
    "rigs": ("study.runs", 200),
    "spread": ("study.runs", 2000),
    "profile": ("study.intervals", 400),
    "curve_bands": ("study.intervals", 400),
    "backbone": ("backbone", 20),
    "modes": ("modes", 20),
    "laws": ("laws", 40),
    "plan": ("plan", 20),
    "loops": ("plan", 20),
    "measured": ("measured", None),
    "answer": ("measured", None),
    "random_force_kinds": ("random_force_kinds", None),
    "driven": ("driven", None),
    "servo": ("servo", None),
    "public": ("public.command", None),
    "arena": ("arena", 10),
    "certified": ("certified_scores", 0),
    "simulator": ("timing", None),
    "timing": ("timing", None),
    "cost": ("cost", None),
    "campaign": ("campaign", 1000),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("name", choices=[*NAMES])
    parser.add_argument("--seeds", "--records", type=int, help="how many (at most, for precision)")
    parser.add_argument("--first", type=int, default=0, help="first seed of verdicts, rigs, plan, loops")
    parser.add_argument("--method", default="", help="direct, trajectory, averaging, or one with -off")
    parser.add_argument("--only", default="", help="part of the titles of what is done")
    parser.add_argument(
        "--out", type=Path, help="file of rows that is gone on with; public: JSON of a submission"
    )
    parser.add_argument("--answers", type=Path, help="certified: a table of answers to score")
    parser.add_argument("--quick", action="store_true", help="timing: the shorter half")
    parser.add_argument("--noise", choices=("white", "AR(0.8)"), default="white", help="of verdicts")
    parser.add_argument("--left-out", action="store_true", help="verdicts: forces that are left out alone")
    parser.add_argument("--unlike", type=float, default=1.0, help="agreement: density of the second run")
    parser.add_argument("--measured", action="store_true", help="bands: the measured records")
    parser.add_argument("--also", default="", metavar="SYMBOLS", help="bands --measured: further effects")
    parser.add_argument("--across", action="store_true", help="bands --measured: the swing across")
    parser.add_argument("--drawn", type=int, nargs="?", const=1, default=0, metavar="N", help=(
        "plan: what is hidden is drawn from all candidates; random_force_kinds: draws of rows of each kind"
    ))  # fmt: skip
    parser.add_argument("--simulated", type=int, default=0, metavar="N", help="random_force_kinds: of each")
    parser.add_argument("--samples", type=int, default=1_000_000, help="cost: the most")
    parser.add_argument("--every", type=float, default=30.0, help="campaign: s between kills of a worker")
    parser.add_argument(
        "--folder", type=Path, help="public: folder of the official files; else they are downloaded"
    )
    parser.add_argument(
        "--stand-ins", action="store_true", help="public: simulated and held-out parts as tests"
    )
    parser.add_argument(
        "--unverified", action="store_true", help="public: use files that are not the official ones"
    )
    parser.add_argument("--call", nargs="+", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    place, count = NAMES[asked.name]
    asked.seeds = count if asked.seeds is None else asked.seeds
    getattr(import_module(f"benchmarks.{place}"), asked.name)(asked)


if __name__ == "__main__":
    main()
