"""Answers of the package rolldecay-estimators (0.6.0) on the certified decays, as a table.

It has an environment of its own and needs nothing of this package but the folder of the decays:

    python -m venv rolldecay && rolldecay/bin/pip install rolldecay-estimators==0.6.0
    PYTHONHASHSEED=0 rolldecay/bin/python benchmarks/rolldecay.py sysid_trib/datasets/certified rolldecay.csv
    python -m benchmarks certified --answers rolldecay.csv

As its documentation does, a low-pass filter gives the derivatives, a fit to the acceleration the start, and a
fit of the simulated motion the answer. It takes phi'' + B_1 phi' + B_2 |phi'| phi' + C_1 phi + C_3 phi^3 = 0;
decays with other forces are left out. Angle and rate of the start are those of the filtered record. The order
of its parameters, and where its fit ends, depend on the seed of the hashes.
"""

import sys
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
from rolldecayestimators.direct_estimator_cubic import (
    EstimatorLinear,
    EstimatorQuadraticB,
    EstimatorQuadraticBandC,
)
from rolldecayestimators.transformers import LowpassFilterDerivatorTransformer

# Unknowns of a decay, and the smallest of its models that has them.
MODELS = {
    frozenset({"zeta"}): EstimatorLinear,
    frozenset({"delta"}): EstimatorQuadraticB,
    frozenset({"zeta", "delta"}): EstimatorQuadraticB,
    frozenset({"zeta", "epsilon"}): EstimatorQuadraticBandC,
    frozenset({"zeta", "delta", "epsilon"}): EstimatorQuadraticBandC,
}
# Cut-off of the filter (Hz): a lower one removes the third harmonic of the stiff spring and the rate.
CUT_OFF = 20.0


def answer(kind: type, record: pd.DataFrame) -> dict[str, float]:
    """Return the coefficients of a record, converted to those of the certified decays."""
    roll = pd.DataFrame({"phi": record["angle (rad)"].to_numpy()}, index=record["time (s)"].to_numpy())
    rate = 1.0 / np.median(np.diff(roll.index))
    derive = LowpassFilterDerivatorTransformer(cutoff=min(CUT_OFF, 0.45 * rate), minimum_score=0.5)
    filtered = derive.fit(roll).transform(roll)
    first = kind(fit_method="derivation")
    first.fit(filtered)
    start = {**first.parameters, "B_1A": max(first.parameters["B_1A"], 1e-6)}
    last = kind(fit_method="integration", p0=start)
    last.fit(filtered)
    found = last.parameters
    w = float(np.sqrt(found["C_1A"]))
    return {
        "reference_frequency": w,
        "zeta": found["B_1A"] / (2.0 * w),
        "delta": found.get("B_2A", np.nan),
        "epsilon": found.get("C_3A", np.nan) / w**2,
    }


def main() -> None:
    folder, output = map(Path, sys.argv[1:])
    rows = []
    for decay in pd.read_csv(folder / "decays.csv").to_dict("records"):
        scored = [name for name in decay["unknowns"].split() if not name.startswith("start_")]
        kind = MODELS.get(frozenset(scored) - {"reference_frequency"})
        if kind is None:
            continue
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = answer(kind, pd.read_csv(folder.parent / f"{decay['name']}.csv.gz"))
        # The package raises errors of many kinds.
        except Exception as error:
            print(f"{decay['name']}: {type(error).__name__}: {error}", file=sys.stderr)
            found = {}
        rows += [{"name": decay["name"], "coefficient": k, "value": found.get(k, np.nan)} for k in scored]
        print(decay["name"], {k: found.get(k) for k in scored}, flush=True)
    pd.DataFrame(rows).to_csv(output, index=False)


if __name__ == "__main__":
    main()
