"""The work behind the page: one record, read and identified in stages. Runs in a worker process."""

import base64
import html
import inspect
import io
import math
import traceback
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import sysid_trib as st
from sysid_trib.app.messages import TITLES, Failure, Request, Section, Signal

# Bins of the drawn signal; each has its smallest and its largest sample.
BINS = 1500
NO_MEMORY = "Out of memory: choose a shorter window, or a record with a lower sampling rate."
EXAMPLE = "Synthetic example"


def sample_names() -> list[str]:
    """Return the names of the records that come with the package."""
    return [EXAMPLE]


def messages_of(request: Request, tell: Callable[..., None]) -> Iterator[Signal | Section | Failure]:
    """Read and identify a record; yield each stage when it is done, and errors as sentences.

    Parameters
    ----------
    request : Request
    tell : callable
        Called with the name of the current work and, if known, its completed fraction.
    """
    read = _outcome(partial(_signal, request))
    yield read
    if isinstance(read, Failure):
        return
    if request.suggest:
        request = replace(request, system=read.system, forces=read.forces)
    for name in [*TITLES] if request.laws else [*TITLES][:-1]:
        tell(TITLES[name])
        made = _outcome(partial(_part, request, name, tell))
        yield replace(made, part=name) if isinstance(made, Failure) else made


def _outcome(work: Callable[[], Any]) -> Any:
    """Return the result of some work, or the sentence on its failure."""
    try:
        return work()
    except st.errors.SysidTribError as error:
        return Failure(str(error), getattr(error, "choices", ()))
    except MemoryError:
        return Failure(NO_MEMORY)
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(frame.filename).name}:{frame.lineno}"
        return Failure(f"Internal error ({type(error).__name__} in {place}: {error}); please report it.")


@lru_cache(maxsize=1)
def _records(file: Path | None, reading: frozenset[tuple[str, Any]]) -> list[Any]:
    if file is None:
        return [st.records.paper_twin()]
    return st.records.read_records(file, st.records.Reading(**dict(reading)))


def _decays(request: Request, *, named: bool) -> tuple[list[Any], list[Any]]:
    """Return the records and their free decays, as the commands take them."""
    how: dict[str, Any] = dict(request.reading)
    if request.system:
        system = st.forces.load_systems()[request.system]
        how |= {"usual": system.signal, "gravity": system.swings_under_gravity}
    records = _records(request.file, frozenset(how.items()))
    decays = [st.records.free_decays(r, window=request.window, as_it_is=named) for r in records]
    return records, [decay for those in decays for decay in those]


def _signal(request: Request) -> Signal:
    """Read the record, and say what is in it."""
    records, decays = _decays(request, named=False)
    record = records[0]
    looked = st.look(records, decays)
    attrs = record.attrs
    said = [str(attrs["source"])]
    if request.file is not None:
        said.append(f"{attrs['signal']} in {attrs['angle_unit_in_file']} from column {attrs['angle_column']}")
        said += [attrs["clock"], attrs.get("reading", "")]
    system, forces = _suggested(looked)
    values = record.angle
    time, value = decimated(record.time.values, values.values)
    read = html.escape("; ".join(filter(None, said)))
    margin = 0.05 * np.ptp(value[np.isfinite(value)]).item()
    return Signal(
        text=f"<div class=hint><p>{read}.</p>{st.show(looked)._repr_html_()}</div>",
        time=time,
        value=value,
        ends=(record.time.values[0].item(), record.time.values[-1].item()),
        limits=(np.nanmin(value).item() - margin, np.nanmax(value).item() + margin),
        label=f"{values.attrs.get('long_name', 'signal')} ({values.attrs.get('units', '')})",
        columns=str(attrs.get("columns_in_file", "")).split("; "),
        system=system,
        forces=forces,
    )


def _suggested(looked: Any) -> tuple[str, tuple[str, ...]]:
    """Return the system and forces to which all decays point, with viscous friction."""
    attrs = [node.attrs for name, node in looked.children.items() if name.startswith("decay")]
    systems = {of["points_to_system"] for of in attrs}
    system = systems.pop() if len(systems) == 1 else ""
    library = st.load_library()
    pointed = {symbol for of in attrs for symbol in of["points_to_forces"].split(",") if symbol}
    if not pointed:
        pointed = {force.symbol for of in attrs if (force := library.role(of["damping_law"])) is not None}
    pointed |= {*[*library.damping_factors][:1]}
    return system, tuple(symbol for symbol in force_names(system) if symbol in pointed)


def force_names(system: str) -> dict[str, str]:
    """Return the names of the forces that can be chosen for a system, by symbol."""
    usual = st.load_library()
    stiffness = usual.role("x")
    known = {force.symbol: force.name for force in usual if force != stiffness}
    if not system:
        return known
    impossible = st.forces.load_systems()[system].impossible
    model, constraints = st.system(system)
    known |= {force.symbol: force.name for force in model}
    held = {symbol for symbol, value in constraints.items() if isinstance(value, float)}
    return {symbol: name for symbol, name in known.items() if symbol not in {*impossible, *held}}


def usual_forces(system: str) -> tuple[str, ...]:
    """Return the forces that are identified if none are chosen."""
    return st.forces.load_systems()[system].forces if system else tuple(force_names(""))


def decimated(time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and the largest sample of each of `BINS` bins, if there are more samples."""
    if value.size <= 2 * BINS:
        return time, value
    edges = np.linspace(0, value.size, BINS, endpoint=False).astype(int)
    ends = np.column_stack([np.fmin.reduceat(value, edges), np.fmax.reduceat(value, edges)])
    return np.repeat(time[edges], 2), ends.ravel()


def _part(request: Request, name: str, tell: Callable[..., None]) -> Section:
    """Compute one of `TITLES`."""
    _, decays = _decays(request, named=name == "identify" and bool(request.forces))
    command = request.command(name)

    def progress(activity: str, done: float | None = None) -> None:
        tell(f"{TITLES[name]}: {activity}", done)

    if name == "backbone":
        curves = [st.backbone(decay) for decay in decays]
        texts = [_figure(st.plots.backbone, curve) + _folded(curve, "Numbers") for curve in curves]
        return Section(name, "".join(texts), command)
    if name == "laws":
        result = st.laws(decays, request.system or None, tell=progress)
        numbers, content = _laws(result)
    else:
        library: Any = ",".join(request.forces) or None
        constraints: Any = {}
        if request.system:
            library, constraints = st.system(request.system, request.forces or None)
        result = st.identify(decays, library, constraints=constraints, tell=progress)
        numbers, content = st.summary(result), _coefficients(result) + _figure(st.plots.overview, result)
    verdict = st.show(result).blocks[0].sentences[0]
    result.attrs["command"] = command
    progress("report")
    files = [request.folder / f"{name}.html", request.folder / f"{name}.csv"]
    st.report(result, files[0])
    numbers.to_csv(files[1])
    content += _folded(result, "All that is printed")
    if name == "identify":
        return Section(name, content, command, files, verdict)
    return Section(name, f"<p class=verdict>{html.escape(verdict)}</p>{content}", command, files)


def _laws(result: Any) -> tuple[pd.DataFrame, str]:
    """Return the preferred laws with errors and bands, a row for each point of a curve, and their figure."""
    try:
        best = st.best(result)
    except st.errors.UsageError:
        # The motion by every method diverges: there are no laws, only a text that says so.
        return st.summary(result), ""
    tables = []
    for law, over in (("friction", "speed"), ("restoring", "displacement")):
        names = {law: "value"} | {f"{law}_{part}": part for part in ("standard_error", "low", "high")}
        table = best[list(names)].to_dataframe().rename(columns=names).rename_axis("at").reset_index()
        table.insert(0, "law", law)
        table.insert(1, "over", over)
        tables.append(table.assign(unit=best[law].attrs.get("units", "")))
    return pd.concat(tables).set_index(["law", "over", "at"]), _figure(st.plots.laws, result, width=7.0)


def _coefficients(result: Any) -> str:
    """Return a table of the preferred coefficients: value, standard error and unit."""
    best = st.best(result)
    method = best.attrs["method"]
    names = dict(zip(best.force.values, best.name.values, strict=True))
    table = st.summary(result).loc[method].reset_index()
    full = {symbol: name if name == symbol else f"{name} ({symbol})" for symbol, name in names.items()}
    table["quantity"] = [full.get(quantity, quantity.replace("_", " ")) for quantity in table.quantity]
    numbers = zip(table.value, table.standard_error, strict=True)
    table[["value", "standard_error"]] = [_rounded(value, error) for value, error in numbers]
    table = table[["quantity", "value", "standard_error", "unit"]]
    rows = table.rename(columns={"standard_error": "standard error"}).to_html(index=False, border=0)
    return f"<p>Preferred method: {html.escape(method)}</p>{rows}"


def _rounded(value: float, error: float) -> tuple[str, str]:
    """Return a value and its error as texts: two digits of the error, and the value to the same decimal."""
    if not error > 0.0:
        return f"{value:g}", "fixed"
    decimals = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{decimals}f}", f"{error:.{decimals}f}"


def _folded(result: Any, title: str) -> str:
    return f"<details><summary>{title}</summary>{st.show(result)._repr_html_()}</details>"


def _figure(draw: Callable[..., Any], result: Any, **options: Any) -> str:
    """Return a figure as an image, which cannot run scripts, with its caption."""
    written = io.BytesIO()
    draw(result, **options).savefig(written, format="svg")
    data = base64.b64encode(written.getvalue()).decode()
    described = " ".join((inspect.getdoc(draw) or "").partition("\n\nParameters\n")[0].split())
    caption = html.escape(described)
    image = f'<img alt="{caption}" src="data:image/svg+xml;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
