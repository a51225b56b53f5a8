"""The strong form of direct identification: `pysindy.SINDy` on derivatives of the smoothed record."""

from collections.abc import Callable

import numpy as np

from sysid_trib.regression.rows import Guess, Mask, Path, Problem, Rows, moved, rms_forces
from sysid_trib.regression.weak_form import smooth


def strong_form(
    problem: Problem, guess: Guess, path: Path, select: Callable[[Rows], Mask]
) -> tuple[Guess, Rows, Mask]:
    """Regress theta'' + theta of the smoothed record on the forces that `select` keeps, by `pysindy.SINDy`.

    For comparison: the noise of second derivatives makes it far less precise than the weak form, and
    smoothing biases it.
    """
    import pysindy
    from pysindy.feature_library import IdentityLibrary
    from pysindy.optimizers import STLSQ

    x, _, acceleration, _ = smooth(problem.form, problem.angle)
    k = (guess.frequency / problem.nominal) ** 2
    scale = rms_forces(path)
    nuisances = [-np.ones_like(x)] + ([x] if problem.free else [])
    lags = 2 * round(2.0 * np.pi / float(np.median(np.diff(problem.form.tau))))
    rows = Rows(-(acceleration / k + x), path.columns / scale, np.column_stack(nuisances), scale, lags)
    active = select(rows)
    # The columns hold states and memory carried along: SINDy takes them as they are, as its states.
    columns = np.column_stack([rows.columns[:, active], rows.nuisances])
    sindy = pysindy.SINDy(optimizer=STLSQ(threshold=0.0, alpha=0.0), feature_library=IdentityLibrary())
    sindy.fit(columns, t=problem.time, x_dot=rows.y[:, None])
    solution = sindy.coefficients()[0]
    count = int(np.sum(active))
    coefficients = np.zeros(len(active))
    coefficients[active] = solution[:count] / rows.scale[active]
    return moved(problem, guess, coefficients, solution[count:]), rows, active
