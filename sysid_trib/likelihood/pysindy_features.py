"""The forces of a library as a feature library of pysindy, and an optimiser for it."""

import ast
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pysindy import AxesArray
from pysindy.feature_library.base import BaseFeatureLibrary, x_sequence_or_item
from pysindy.optimizers import BaseOptimizer
from sklearn.utils.validation import check_is_fitted

from sysid_trib import forces
from sysid_trib.arrays import Array, Index
from sysid_trib.errors import DecayError, LibraryError
from sysid_trib.forces.force import Force, LibraryLike, ShapeValues
from sysid_trib.likelihood.force_columns import value_along
from sysid_trib.likelihood.least_squares import white_least_squares, whitened
from sysid_trib.records.inputs import KnownInput, values_of_inputs

# Names that pysindy gives to unnamed inputs.
UNNAMED = ["x0", "x1"]


class ForceFeatures(BaseFeatureLibrary):
    """One feature for each force of a library, on the states [theta, theta'] with theta' = dtheta/d(w t).

    Inputs of the forces are those of pysindy, `model.fit(..., u=inputs)`: one column each, in the order of
    `library.inputs`.

    Parameters
    ----------
    library : ForceLibrary, str, or what `library` takes
        The forces; sensor terms do not act in the equation of motion and are left out.
    sampling_time : float, s, optional
        Needed by forces with states, memory, `t` or the derivative of an input: these are integrated along
        each trajectory, which starts at t = 0.
    reference_frequency : float, rad/s, optional
        Reference frequency w, needed by forces with states, memory, or an input that w scales.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`; default values for missing ones.

    Raises
    ------
    UsageError
        The argument does not specify a library. `fit` raises the errors of the data.

    Examples
    --------
    >>> import numpy as np
    >>> import pysindy
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.0097, "epsilon": 0.3}, reference_frequency=10.0)
    >>> motion = st.simulate(model, np.arange(0.0, 10.0, 0.001), angle=0.3)
    >>> states = np.column_stack([motion.angle, motion.rate / 10.0])
    >>> target = -np.gradient(states[:, 1], 0.01) - states[:, 0]
    >>> features = st.ForceFeatures("zeta,epsilon")
    >>> sindy = pysindy.SINDy(pysindy.STLSQ(threshold=0.0, alpha=0.0), features)
    >>> _ = sindy.fit(states, t=0.01, x_dot=target[:, None])
    >>> dict(zip(features.get_feature_names(), sindy.coefficients()[0].round(4).tolist()))
    {"2 theta'": 0.0097, 'theta^3': 0.2997}
    """

    def __init__(
        self,
        library: LibraryLike,
        sampling_time: float | None = None,
        reference_frequency: float | None = None,
        shapes: ShapeValues | None = None,
    ) -> None:
        self.library = forces.as_library(library, "ForceFeatures")
        self.sampling_time = sampling_time
        self.reference_frequency = reference_frequency
        self.shapes = shapes

    @x_sequence_or_item
    def fit(self, x_full: Sequence[Any], y: object = None) -> "ForceFeatures":
        """Check that the forces can be computed from the trajectories.

        Parameters
        ----------
        x_full : (sample, 2) array of float, rad, or a list of them
            Each trajectory: theta and theta', and a column for each input.
        y : object
            Not used.

        Raises
        ------
        DecayError
            The data do not have two columns.
        LibraryError
            A force needs `sampling_time` or `reference_frequency`, which is missing; or the library has no
            forces.
        """
        for x in x_full:
            _check_columns(x, self.library.inputs)
        if not self._forces:
            raise LibraryError(f"Library '{self.library.title}' has no forces to make features of.")
        for force in self._forces:
            self._check_given(force)
        self.n_features_in_ = 2 + len(self.library.inputs)
        self.n_output_features_ = len(self._forces)
        return self

    @x_sequence_or_item
    def transform(self, x_full: Sequence[Any]) -> list[AxesArray]:
        """Return the value of every force along each trajectory, (sample, force).

        Examples
        --------
        >>> import numpy as np
        >>> import sysid_trib as st
        >>> states = np.array([[0.3, 0.0], [0.2, -0.1]])
        >>> st.ForceFeatures("zeta,epsilon").fit_transform(states).round(3).tolist()
        [[0.0, 0.027], [-0.2, 0.008]]
        """
        check_is_fitted(self)
        return [self._columns(x) for x in x_full]

    def get_feature_names(self, input_features: Sequence[str] | None = None) -> list[str]:
        """Return formulas in readable form, in theta and theta' unless the inputs have other names.

        Examples
        --------
        >>> import sysid_trib as st
        >>> st.ForceFeatures("zeta,nu").get_feature_names()
        ["2 theta'", 'theta |theta|']
        """
        given = UNNAMED if input_features is None else list(input_features)[:2]
        angle, rate = ("theta", "theta'") if given == UNNAMED else given
        return [readable(force, angle, rate, self.shapes) for force in self._forces]

    @property
    def _forces(self) -> list[Force]:
        return [force for force in self.library if force.kind == "force"]

    def _check_given(self, force: Force) -> None:
        over_time = force.holds_time or not force.memoryless or any(c.order for c in force.channels)
        scaled = not force.memoryless or any(channel.power for channel in force.channels)
        needs = {"sampling_time (s)": (self.sampling_time, over_time)}
        needs["reference_frequency (rad/s)"] = (self.reference_frequency, scaled)
        for name, (value, needed) in needs.items():
            if needed and not (value is not None and np.isfinite(value) and value > 0):
                raise LibraryError(
                    f"Force '{force.symbol}' depends on time: give ForceFeatures a positive {name}."
                )

    def evaluate(
        self, time: Array, angle: Array, rate: Array, inputs: Mapping[str, KnownInput] | None = None
    ) -> Array:
        """Return the value of every force along a motion at given times.

        Parameters
        ----------
        time : (sample,) array of float, s
            Time from the first sample.
        angle, rate : (sample,) array of float, rad
            theta and theta'.
        inputs : mapping of str to KnownInput, optional
            Inputs of the forces; missing ones are zero.

        Returns
        -------
        (sample, force) array of float, rad

        Examples
        --------
        >>> import numpy as np
        >>> import sysid_trib as st
        >>> time, angle, rate = np.array([[0.0, 0.1], [0.3, 0.2], [0.0, -0.1]])
        >>> st.ForceFeatures("zeta,epsilon").evaluate(time, angle, rate).round(3).tolist()
        [[0.0, 0.027], [-0.2, 0.008]]
        """
        frequency = float(self.reference_frequency or 1.0)

        def given(force: Force, at: Array) -> dict[str, Array]:
            return values_of_inputs(inputs or {}, force.channels, at, frequency)

        motion = time, angle, rate
        values = [value_along(force, motion, frequency, self.shapes, given) for force in self._forces]
        return np.stack(values, axis=1)

    def _columns(self, x: Any) -> AxesArray:
        _check_columns(x, self.library.inputs)
        states = np.asarray(x)
        angle, rate, *inputs = states.T.astype(float)
        time = np.arange(len(states), dtype=np.float64) * np.float64(self.sampling_time or 1.0)
        pairs = zip(self.library.inputs, inputs, strict=True)
        known = {name: KnownInput(time, values, "smooth") for name, values in pairs}
        columns = self.evaluate(time, angle, rate, known)
        dtype = np.result_type(states.dtype, np.float32)
        return AxesArray(columns.astype(dtype, copy=False), {"ax_time": 0, "ax_coord": 1})


def readable(
    force: Force, angle: str = "theta", rate: str = "theta'", shapes: ShapeValues | None = None
) -> str:
    """Return a readable formula, e.g. `theta' |theta'|`; sums in brackets, states with the symbol."""
    names = {"x": angle, "v": rate} | {k: f"{force.symbol}.{k}" for k in (*force.state, *force.memory)}
    names |= {k: f"{value:g}" for k, value in force.shape_values(shapes).items()}
    tree = _spoken(force.formula.tree, names | {"sign": "sgn"})
    text = ast.unparse(tree)
    for sign, spoken in ((" * ", " "), (" / ", "/"), (" ** ", "^")):
        text = text.replace(sign, spoken)
    is_sum = text.startswith("-") or isinstance(getattr(tree, "op", None), ast.Add | ast.Sub)
    return f"({text})" if is_sum else text


def _spoken(tree: ast.AST, names: Mapping[str, str]) -> Any:
    """Return the tree of a formula with readable names, numbers and functions as names."""
    match tree:
        case ast.Name(id=name):
            return ast.Name(names.get(name, name))
        case ast.Constant(value=value):
            return ast.Name(f"{float(value):.12g}")  # type: ignore[arg-type]
        case ast.UnaryOp(op=op, operand=operand):
            return ast.UnaryOp(op, _spoken(operand, names))
        case ast.BinOp(left=left, op=op, right=right):
            return ast.BinOp(_spoken(left, names), op, _spoken(right, names))
        case ast.Call(func=function, args=args):
            inner = [_spoken(arg, names) for arg in args]
            if isinstance(function, ast.Name) and function.id == "abs":
                return ast.Name(f"|{ast.unparse(inner[0])}|")
            return ast.Call(_spoken(function, names), inner, [])
    raise AssertionError(f"unchecked tree: {ast.dump(tree)}")


def _check_columns(x: Any, inputs: Sequence[str]) -> None:
    shape = np.shape(x)
    if len(shape) != 2 or shape[1] != 2 + len(inputs):
        wanted = f", and a column each of the inputs {', '.join(inputs)} (pysindy's u=)" if inputs else ""
        raise DecayError(
            f"Force features need the two columns theta and theta' = dtheta/d(w t) (rad){wanted}, "
            f"not data of shape {shape}."
        )


class WhitenedLeastSquares(BaseOptimizer):
    """Least squares of rows whose noise has a known covariance up to a factor, with standard errors.

    `Direct` solves its rows by this least squares; it serves `pysindy.SINDy(optimizer=...)` too.

    Parameters
    ----------
    covariance_factor : (band, row) array of float, optional
        Cholesky factor of the covariance of the rows' noise, lower banded in the form of `scipy.linalg`.
        Without it the rows are white.
    correlation_lags : int, default 0
        Number of lags over which the errors allow for correlation, if the residuals of the whitened rows are
        correlated (Newey and West 1987); 0 means white.
    curves : sequence of arrays of int, optional
        Features whose coefficients are random effects of one variance each (see `smooth_least_squares`).

    Attributes
    ----------
    coef_ : (target, feature) array of float
        Coefficients.
    covariance_ : (target, feature, feature) array of float
        Covariance of the coefficients.
    noise_ : (target,) array of float
        RMS residual of the whitened rows.
    lags_ : (target,) array of int
        Number of lags over which the errors allow for correlation.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> time = np.linspace(0.0, 1.0, 200)
    >>> rows = 1.0 + 2.0 * time + np.random.default_rng(0).normal(0.0, 0.1, 200)
    >>> fit = st.forces.WhitenedLeastSquares().fit(np.stack([np.ones(200), time], axis=1), rows)
    >>> fit.coef_[0].round(1).tolist(), fit.noise_[0].round(1).item()
    ([1.0, 2.0], 0.1)
    """

    def __init__(
        self,
        covariance_factor: Array | None = None,
        correlation_lags: int = 0,
        curves: Sequence[Index] | None = None,
    ) -> None:
        super().__init__(unbias=False)
        self.covariance_factor = covariance_factor
        self.correlation_lags = correlation_lags
        self.curves = curves

    def fit(self, x_: Any, y: Any, sample_weight: Any = None, **reduce_kws: Any) -> "WhitenedLeastSquares":
        """Whiten the rows and solve them, once; see `pysindy.optimizers.BaseOptimizer.fit`."""
        # The checks and the first estimate of BaseOptimizer.fit would take ten times as long as the solution.
        x, y = (np.asarray(part, dtype=float).reshape(len(part), -1) for part in (x_, y))
        if self.covariance_factor is None:
            weights = np.sqrt(np.broadcast_to(1.0 if sample_weight is None else sample_weight, len(x)))
            finite = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
            x, y = ((weights[:, None] * part)[finite] for part in (x, y))
        self._reduce(x, y)
        self.Theta_, self.ind_, self.history_, self.intercept_ = x, self.coef_ != 0.0, [self.coef_], 0.0
        return self

    def _reduce(self, x: Array, y: Array) -> None:
        columns, targets = (whitened(self.covariance_factor, part) for part in (x, y))
        solutions = [
            white_least_squares(columns, target, self.correlation_lags, self.curves or ())
            for target in targets.T
        ]
        coefficients, covariances, noises, lags = zip(*solutions, strict=True)
        self.coef_, self.covariance_ = np.stack(coefficients), np.stack(covariances)
        self.noise_, self.lags_ = np.array(noises), np.array(lags)
