"""The strong form of direct identification: `pysindy.SINDy` on derivatives of the smoothed record."""

from collections.abc import Callable, Sequence

import numpy as np

from sysid_trib.noise.smoothing import smooth
from sysid_trib.regression.rows import Mask, Rows, Run, moved, rms_forces, together


def strong_form(runs: Sequence[Run], select: Callable[[Rows], Mask]) -> tuple[tuple[Run, ...], Rows, Mask]:
    """Regress theta'' + theta of the smoothed record on the forces that `select` keeps, by `pysindy.SINDy`.

    For comparison: the noise of second derivatives makes it far less precise than the weak form, and
    smoothing biases it.
    """
    import pysindy
    from pysindy.feature_library import IdentityLibrary
    from pysindy.optimizers import STLSQ

    rows = together([_strong_rows(run) for run in runs], [run.problem.noise for run in runs])
    active = select(rows)
    # The columns hold states and memory carried along: SINDy takes them as they are, as its states.
    columns = np.column_stack([rows.columns[:, active], rows.nuisances])
    sindy = pysindy.SINDy(optimizer=STLSQ(threshold=0.0, alpha=0.0), feature_library=IdentityLibrary())
    # With derivatives given, time is but a count of the samples.
    sindy.fit(columns, t=np.arange(len(columns), dtype=float), x_dot=rows.y[:, None])
    solution = sindy.coefficients()[0]
    count = int(np.sum(active))
    coefficients = np.zeros(len(active))
    coefficients[active] = solution[:count] / rows.scale[active]
    return moved(runs, coefficients, solution[count:]), rows, active


def _strong_rows(run: Run) -> Rows:
    problem, path = run.problem, run.path
    x, _, acceleration, _ = smooth(problem.form.tau, problem.angle)
    k = (run.guess.frequency / problem.nominal) ** 2
    scale = rms_forces(path)
    nuisances = [-np.ones_like(x)] + ([x] if problem.free else [])
    lags = 2 * round(2.0 * np.pi / float(np.median(np.diff(problem.form.tau))))
    return Rows(-(acceleration / k + x), path.columns / scale, np.column_stack(nuisances), scale, lags)
