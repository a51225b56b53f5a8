"""The laws of two samples in sentences: at which speeds and displacements they differ."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from sysid_trib.printing import Block, layout
from sysid_trib.results.kinds import SIDES
from sysid_trib.results.law_curves import LAW_DIFFERENCE, LAW_WORDS, VARIABLE_OF_LAW, stretches
from sysid_trib.results.variables import CONFIDENCE, signal_units

LAWS_TITLE = "Difference of the laws"
# Significance level for a difference anywhere along a law.
NO_DIFFERENCE_LEVEL = 1.0 - CONFIDENCE
# Largest number of rows in the table of a law.
MOST_PLACES = 8


def sample_names(data: xr.Dataset) -> list[str]:
    """Return the names of the samples: their files, or first and second if these are equal."""
    names = [sample_name(data.attrs[f"{side}_record"], side) for side in SIDES]
    return list(SIDES) if names[0] == names[1] else names


def sample_name(sources: Sequence[str], otherwise: str) -> str:
    """Return a short name for records that are files."""
    names = [Path(source).name for source in sources if source]
    return f"{names[0]} and {len(names) - 1} more" if len(names) > 1 else "".join(names) or otherwise


def law_sentences(tree: xr.DataTree) -> Iterator[str]:
    """Describe where the samples differ in each law, and the significance; nothing without laws."""
    if LAW_DIFFERENCE not in tree.children:
        return
    data, (first, second) = tree[LAW_DIFFERENCE].to_dataset(), sample_names(tree.to_dataset())
    for law, variable in VARIABLE_OF_LAW.items():
        places = data[variable].values
        unit = data[variable].attrs["units"]
        p_value = layout.p_value_text(data[f"{law}_p_value"].item())
        ends = f"{np.abs(places).min():.3g} to {np.abs(places).max():.3g} {unit}"
        if not data[f"{law}_differs"].any():
            yield (
                f"No difference was found in the {LAW_WORDS[law]} of {first} and {second}, at any "
                f"{variable} that both visit ({ends}; p {p_value})."
            )
            continue
        parts = [f"{way} at {where}" for way, where in _directions(data, law) if where]
        yield (
            f"The {LAW_WORDS[law]} of {first} is {' and '.join(parts)} {unit} than that of {second} "
            f"(simultaneous 95 % band over the {variable}s of both, {ends}; p {p_value})."
        )


def _directions(data: xr.Dataset, law: str) -> list[tuple[str, str]]:
    """Return the direction in which the first law differs from the second, and the ranges of each."""
    places = data[VARIABLE_OF_LAW[law]].values
    # A larger friction acts more strongly against the motion in either direction.
    difference = np.sign(places) * data[f"{law}_difference"].values
    differs = data[f"{law}_differs"].values
    ways = {"larger": differs & (difference > 0.0), "smaller": differs & (difference < 0.0)}
    said = []
    for way, chosen in ways.items():
        ranges = map(_range_text, stretches(places, chosen))
        said.append((way, ", ".join(ranges)))
    return said


def _range_text(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.3g}" if ends[0] == ends[1] else f"{ends[0]:.3g} to {ends[1]:.3g}"


def law_blocks(tree: xr.DataTree) -> list[Block]:
    """Return the tables of both laws: each sample, the difference and its band, at some places."""
    if LAW_DIFFERENCE not in tree.children:
        return []
    data = tree[LAW_DIFFERENCE].to_dataset()
    percent = f"{100.0 * (1.0 - NO_DIFFERENCE_LEVEL):g} %"
    said = (
        f"Forces are over the inertia. Bands of differences are valid at all places "
        f"together, in {percent}; a "
        "difference counts where its band excludes zero. If the second sample has no contact, the difference "
        "is the force of the contact."
    )
    blocks = [Block([said], title=LAWS_TITLE)]
    names = dict(zip(SIDES, sample_names(tree.to_dataset()), strict=True))
    for law in VARIABLE_OF_LAW:
        caption = f"{LAW_WORDS[law].capitalize()} ({data[law + '_difference'].attrs['units']})"
        blocks.append(Block((), title=LAWS_TITLE, table=_table(data, law, names), caption=caption))
    return blocks


def _table(data: xr.Dataset, law: str, names: dict[str, str]) -> Table:
    variable = VARIABLE_OF_LAW[law]
    unit = data[variable].attrs["units"]
    rows = []
    for at in layout.evenly_chosen(data.sizes[variable], MOST_PLACES):
        row = data.isel({variable: at})
        low, high = (row[f"{law}_difference_{end}"].item() for end in ("low", "high"))
        rows.append(
            {
                f"{variable} ({unit})": f"{row[variable].item():.3g}",
                **{name: layout.quantity(row, f"{law}_{side}") for side, name in names.items()},
                "difference": layout.quantity(row, f"{law}_difference"),
                "95 % band": f"{low:.3g} to {high:.3g}",
                "differs": "yes" if row[f"{law}_differs"].item() else "no",
            }
        )
    return layout.text_table(rows, ("differs",))


def law_difference_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return the difference of the laws as plain data, at the key `laws`; empty if not requested."""
    if LAW_DIFFERENCE not in tree.children:
        return {}
    data = tree[LAW_DIFFERENCE].to_dataset()
    made: dict[str, Any] = {
        "verdict": data.attrs["verdict"],
        "level": NO_DIFFERENCE_LEVEL,
        "signal_units": signal_units(tree),
    }
    for law, variable in VARIABLE_OF_LAW.items():
        columns = (*SIDES, "difference", "z", "differs")
        errors = {f"{name}_standard_error": f"{law}_{name}_standard_error" for name in columns[:3]}
        ends = {name: f"{law}_{name}" for name in ("difference_low", "difference_high")}
        keys = {name: f"{law}_{name}" for name in columns} | errors | ends
        places = data[variable].values
        made[law] = {
            "p_value": data[f"{law}_p_value"].item(),
            "units": data[f"{law}_difference"].attrs["units"],
            variable: places,
            f"{variable}_units": data[variable].attrs["units"],
            "differs_at": stretches(places, data[f"{law}_differs"].values),
        } | {key: data[name].values for key, name in keys.items()}
    return {"laws": made}
