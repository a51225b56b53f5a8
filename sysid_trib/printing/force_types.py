"""Which type of force a gap asks for, by the generic forces that know no candidate."""

import numpy as np
import xarray as xr

CONSERVATIVE, DISSIPATIVE = "conservative", "dissipative"
EVEN, TILTED = "even", "one-sided dissipative"
MEANING = {
    CONSERVATIVE: "a conservative force is missing, or the clock is wrong",
    DISSIPATIVE: "a dissipative force is missing",
    EVEN: "an even force is missing, or the sensor is not linear",
    TILTED: "friction that differs from side to side is missing, or the sensor is not linear",
}
BOTH = {
    frozenset({CONSERVATIVE, DISSIPATIVE}): "forces of both types are missing, or one with memory",
    frozenset({EVEN, TILTED}): MEANING[EVEN],
}
# A second type that scores this part of the first cannot be excluded.
NEAR = 0.8


def force_type_sentence(tree: xr.DataTree, scan: int) -> str:
    """The type of generic force that scores highest, and what it means; empty if none stands out.

    Notes
    -----
    A fit trades phase for amplitude where the frequency depends on amplitude, so that the gap itself does not
    tell the type; scores do, as they leave out what the model's unknowns can do.
    """
    generic = tree["omnibus"].to_dataset().isel(selection_step=scan)
    if not generic.significant:
        return ""
    best: dict[str, float] = {}
    for name, z in zip(
        generic["trial_force"].values.tolist(), np.abs(generic.z.values).tolist(), strict=True
    ):
        kind = _kind_of(name)
        best[kind] = max(best.get(kind, 0.0), z)
    ordered = sorted(best, key=lambda kind: -best[kind])
    scores = ", ".join(f"{kind} {best[kind]:.3g}" for kind in ordered)
    near = [kind for kind in ordered if best[kind] > NEAR * best[ordered[0]]]
    if len(near) == 1:
        meaning = MEANING[near[0]]
    elif len(near) == 2 and frozenset(near) in BOTH:
        meaning = BOTH[frozenset(near)]
    else:
        meaning = "forces of several types would explain it"
    return f"By generic forces (|z| at most: {scores}), {meaning}."


def _kind_of(name: str) -> str:
    """Type of r^k, r^k cos m phi or r^k sin m phi: even m is even, a sine goes with speed."""
    _, *wave = name.split()
    if not wave:
        return EVEN
    even = int(wave[1]) % 2 == 0
    if wave[0] == "cos":
        return EVEN if even else CONSERVATIVE
    return TILTED if even else DISSIPATIVE
