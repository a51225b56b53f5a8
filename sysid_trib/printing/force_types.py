"""Which type of force a gap asks for, by the omnibus test that knows no candidate."""

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
    frozenset({CONSERVATIVE, DISSIPATIVE}): "forces of both types are missing, or a history-dependent one",
    frozenset({EVEN, TILTED}): MEANING[EVEN],
}
# A second type that scores this part of the first cannot be excluded.
NEARLY_AS_HIGH = 0.8


def force_type_sentence(tree: xr.DataTree, selection_step: int) -> str:
    """The type of force that scores highest in the omnibus test, and what it means.

    Parameters
    ----------
    tree : DataTree
        Result of `discover`.
    selection_step : int
        The test before this step; -1 for that of the final model.

    Returns
    -------
    str
        Empty if the test does not reject.

    Notes
    -----
    A fit trades phase for amplitude where the frequency depends on amplitude, so that the gap itself does not
    show the type. Scores do: what the model's parameters can do is projected out of them.
    """
    omnibus = tree["omnibus"].to_dataset().isel(selection_step=selection_step)
    if not omnibus.significant:
        return ""
    best = abs(omnibus.z).to_series().groupby(_kind_of).max().sort_values(ascending=False)
    scores = ", ".join(f"{kind} {z:.3g}" for kind, z in best.items())
    near = frozenset(best.index[best > NEARLY_AS_HIGH * best.max()])
    meanings = BOTH | {frozenset({kind}): meaning for kind, meaning in MEANING.items()}
    meaning = meanings.get(near, "forces of several types would explain it")
    return f"By the omnibus test (largest |z|: {scores}), {meaning}."


def _kind_of(name: str) -> str:
    """Type of r^k, r^k cos m phi or r^k sin m phi: even m is even, a sine goes with speed."""
    _, *wave = name.split()
    if not wave:
        return EVEN
    even = int(wave[1]) % 2 == 0
    if wave[0] == "cos":
        return EVEN if even else CONSERVATIVE
    return TILTED if even else DISSIPATIVE
