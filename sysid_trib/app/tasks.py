"""The work behind the page: one record, read and identified in stages. Runs in a worker process."""

import base64
import html
import inspect
import io
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import sysid_trib as st
from sysid_trib.app.messages import TITLES, Failure, Request, Section, Signal

NO_MEMORY = "Out of memory: choose a shorter window, or a record with a lower sampling rate."


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
        return Failure(st.errors.internal_error_text(error))


@lru_cache(maxsize=1)
def _records(record: str, reading: frozenset[tuple[str, Any]], system: str) -> list[Any]:
    if not record:
        return [st.records.paper_twin()]
    moving = st.forces.load_system(system or None)
    how = st.records.Reading(**dict(reading), usual=moving.signal, gravity=moving.swings_under_gravity)
    return st.records.read_records(record, how)


def _decays(request: Request, *, as_it_is: bool = False) -> tuple[list[Any], list[Any]]:
    """Return the records and their free decays, as the commands take them."""
    records = _records(request.record, frozenset(request.reading.items()), request.system)
    decays = [st.records.free_decays(r, window=request.window, as_it_is=as_it_is) for r in records]
    return records, [decay for those in decays for decay in those]


def _signal(request: Request) -> Signal:
    """Read the record, and say what is in it."""
    records, decays = _decays(request)
    looked = st.look(records, decays)
    attrs = records[0].attrs
    angle = records[0].angle
    time = records[0].time.values
    how = st.records.reading_text(records) if request.record else attrs["synthetic"]
    read = html.escape(f"{attrs['source']}; {how}.")
    shown = st.records.drawn_samples(angle.values)
    system, forces = st.forces.suggested(looked)
    if forces == st.forces.load_system(system or None).usual:
        forces = ()
    return Signal(
        text=f"<p>{read}</p>{st.show(looked)._repr_html_()}",
        time=time[shown],
        value=angle.values[shown],
        label=f"{angle.attrs['long_name']} ({angle.attrs['units']})",
        ends=(time[0].item(), time[-1].item()),
        columns=attrs.get("columns_in_file", "").split("; "),
        system=system,
        forces=forces,
    )


def _part(request: Request, name: str, tell: Callable[..., None]) -> Section:
    """Compute one of `TITLES`."""
    command = request.command(name)
    # A short or growing motion is used as it is if the forces are known.
    _, decays = _decays(request, as_it_is=name == "identify" and bool(request.forces))
    if name == "backbone":
        curves = [st.backbone(decay) for decay in decays]
        texts = [_figure(st.plots.backbone, curve) + st.show(curve)._repr_html_() for curve in curves]
        return Section(name, "".join(texts), command, files=(), verdict="")
    if name == "laws":
        result = st.laws(decays, request.system or None, tell=tell)
        tables = {}
        # There is no law if the motion by every method diverges.
        with suppress(st.errors.UsageError):
            preferred = st.best(result)
            laws = [law for law in ("friction", "restoring") if law in preferred]
            tables = {law: st.physics.law_table(preferred, law) for law in laws}
        figure = _figure(st.plots.laws, result, width=7.0)
    else:
        library: Any = ",".join(request.forces) or None
        constraints: Any = {}
        if request.system:
            library, constraints = st.system(request.system, request.forces or None)
        result = st.identify(decays, library, constraints=constraints, tell=tell)
        tables = {"coefficients": st.summary(result).reset_index()}
        figure = _figure(st.plots.overview, result)
    result.attrs["command"] = command
    tell("report")
    report, shown = request.folder / f"{name}.html", st.show(result)
    st.report(result, report)
    files = [report, *(request.folder / f"{title}.csv" for title in tables)]
    for file, table in zip(files[1:], tables.values(), strict=True):
        table.to_csv(file, index=False)
    text = shown._repr_html_()
    # The curves are the main result of `laws`.
    text = figure + text if name == "laws" else text + figure
    return Section(name, text, command, files, verdict=shown.blocks[0].sentences[0])


def _figure(draw: Callable[..., Any], result: Any, **options: Any) -> str:
    """Return a figure as an image, which cannot run scripts, with its caption."""
    written = io.BytesIO()
    draw(result, **options).savefig(written, format="svg")
    data = base64.b64encode(written.getvalue()).decode()
    described = " ".join((inspect.getdoc(draw) or "").partition("\n\nParameters\n")[0].split())
    caption = html.escape(described)
    image = f'<img alt="{caption}" src="data:image/svg+xml;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
