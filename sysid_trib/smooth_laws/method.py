"""Laws as one of the methods in `compare`."""

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
import xarray as xr

from sysid_trib.errors import DecayError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.random_force import RandomForceOption, check_random_force
from sysid_trib.methods import Averaging, Direct
from sysid_trib.methods.scope import Constrained, Method, MethodScope
from sysid_trib.records.half_sines import envelope
from sysid_trib.records.runs import Decays, as_runs
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.smooth_laws.fits import fitted
from sysid_trib.smooth_laws.model import LawModel, smallest_part, why_no_curve, with_jump
from sysid_trib.validation.driven import is_driven


@dataclass(frozen=True)
class LawMethod(Constrained):
    """Friction and restoring force as curves, by one method, for comparison with methods of named forces.

    Parameters
    ----------
    by : {"direct", "averaging"}
        Method that fits the curves.
    random_force : "auto", "off", "estimated" or float
        As for `methods.Direct`; `auto` means `off`.
    constraints : mapping of str to float, (float, float) or str
        Constraints of the named forces.

    Notes
    -----
    The offered forces are not penalised. See `laws`, which adds errors of the sensor, even parts and bands.
    """

    scope: ClassVar = MethodScope(
        label="laws",
        assumes="friction depends on the speed alone, the restoring force on the displacement alone",
        identifies="friction and restoring force as curves",
        driven=True,
        names_forces=False,
        variants={"averaging": {"by": "averaging"}},
    )

    by: Literal["direct", "averaging"] = "direct"
    random_force: RandomForceOption = "auto"

    def __post_init__(self) -> None:
        check_random_force(self.random_force)

    @in_units_of_the_motion
    def identify(self, decay: Decays, library: ForceLibrary) -> xr.Dataset:
        """Identify the curves, with the forces of a library that are not penalised.

        Parameters
        ----------
        decay : Dataset or sequence of Dataset
            `angle(time)`, and inputs of a driven record.
        library : ForceLibrary
            Named forces.

        Returns
        -------
        Dataset
            As from `methods.Direct`: the basis functions of the curves are forces.

        Raises
        ------
        DecayError
            The record determines no curve.
        """
        runs = as_runs(decay, driven=True)
        random_force: RandomForceOption = "off" if self.random_force == "auto" else self.random_force
        model = LawModel(with_jump(library, library), self.constraints)
        lowest = 0.0
        if not is_driven(runs):
            amplitudes = np.concatenate([np.abs(envelope(run).extremum.values) for run in runs])
            if reason := why_no_curve(amplitudes):
                raise DecayError(reason)
            lowest = smallest_part(amplitudes)
        if self.by == "direct":
            direct = Direct(random_force=random_force, constraints=self.constraints)
            return fitted(runs, direct, model).followed.result
        averaging = Averaging(random_force=random_force, constraints=self.constraints)
        return fitted(runs, averaging, model.of_odd_forces, lowest).followed.result


def law_methods() -> dict[str, Method]:
    """Return the methods that identify laws, for `compare`.

    Returns
    -------
    dict of str to method
        The methods by their labels: from the motion within the cycle, and from averages (see `laws`).

    Examples
    --------
    >>> import sysid_trib as st
    >>> list(st.physics.law_methods())
    ['laws', 'laws (averaging)']
    """
    method = LawMethod()
    label = method.scope.label
    methods: dict[str, Method] = {label: method}
    for name, options in method.scope.variants.items():
        methods[f"{label} ({name})"] = replace(method, **options)
    return methods
