"""Report of the confirmation set against the bars: fractions with 95 % binomial intervals, and failures."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from .effects import names

Row = dict[str, Any]
# z of the truth beyond the best two candidates, above which no two candidates explain the record.
CLEAR = 20.0
# In the place of what is found where an error ended the search.
FAILED = {"verdict": "none", "steps": []}
# Edges of stated probabilities that are counted together.
EDGES = [0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.01]
SINGLE, SEEN = "kind.str.contains('^effect|^strong')", "z >= 8"
BINS = {"8-12": "8 <= z < 12", "12-20": "12 <= z < 20", "> 20": "z >= 20"}


def _bars() -> list[tuple[str, str, str, str]]:
    """Title, what is wanted, of which records, and the share of what."""
    nothing, one, seen = "kind.str.startswith('nothing')", SINGLE, f"{SINGLE} and {SEEN}"
    found = [
        (f"false alarms, {kind}", f"<= {most} %", f"kind == 'nothing {kind}' and not pushed", "alarm")
        for kind, most in (("white", 2), ("coloured", 3), ("quantised", 4))
    ]
    found += [
        (f"of these, {colour}", "", f"{nothing} and colour == '{colour}' and not pushed", "alarm")
        for colour in ("ar1", "ar2", "pink")
    ]
    found.append(("false alarms, random force", "<= 2 %", f"{nothing} and pushed", "alarm"))
    found += [
        (f"of these, {colour}", "", f"{nothing} and colour == '{colour}' and pushed", "alarm")
        for colour in ("white", "ar1", "ar2", "pink", "quantised")
    ]
    for name, of_z in BINS.items():
        some = f"{one} and {of_z}"
        found += [
            (f"truth in the 95 % set, z {name}", "93 to 99 %", some, "hit"),
            ("of these, without a random force", "", f"{some} and not pushed", "hit"),
            ("of these, with a random force", "", f"{some} and pushed", "hit"),
            (f"mean size of the set, z {name}", "", some, "size"),
        ]
    found += [
        ("nothing named, z > 8", "", seen, "none"),
        ("named wrongly and not flagged, z > 8", "<= 1.5 %", seen, "wrong"),
        ('"unknown", truth among the candidates, z > 8', "", seen, "unknown"),
    ]
    for title, kind in (("left out", "left out"), ("in no library", "outside")):
        of_kind, said = f"kind == '{kind}' and", f'"unknown", truth {title}'
        clear = f"{said}, z >= 20 beyond any two candidates"
        found.append((clear, ">= 97 %", f"{of_kind} by_two >= {CLEAR}", "unknown"))
        found.append((f"{said}, smaller z", "", f"{of_kind} by_two < {CLEAR}", "unknown"))
    found.append(("strong effects: truth in its set", ">= 90 %", "kind == 'strong'", "hit"))
    found.append(("strong effects: truth in its set, no other named", ">= 90 %", "kind == 'strong'", "alone"))
    for kind, least in (("two", 90), ("three", 75)):
        some, title = f"kind == '{kind}' and {SEEN}", f"{kind} hidden: each in a set"
        found += [(title, "", some, "hit"), (f"{title}, no other named", f">= {least} %", some, "alone")]
    return found


def frame(rows: Sequence[Row]) -> pd.DataFrame:
    """Return the counted values, a row for each record; a record without a verdict is a miss everywhere."""
    return pd.DataFrame([_counted(row if "found" in row else row | {"found": FAILED}) for row in rows])


def hits_of(row: Row) -> list[bool]:
    """Return for each hidden effect whether it is in the set of a step."""
    sets = [{*step["ties"]} for step in row["found"]["steps"]]
    return [any(names(one["symbol"]) & tied for tied in sets) for one in row["hidden"]]


def _counted(row: Row) -> dict[str, Any]:
    found, hidden, experiment = row["found"], row["hidden"], row["experiment"]
    sets, truths = [{*step["ties"]} for step in found["steps"]], [names(one["symbol"]) for one in hidden]
    hits, verdict = hits_of(row), found["verdict"]
    false = sum(not set().union(*truths) & tied for tied in sets)
    # The set that holds the truth, chance with it, or the first.
    sizes = [len(step["ties"]) + (step["chance"] > 0.0) for step in found["steps"]]
    right = [size for size, tied in zip(sizes, sets, strict=True) if truths and truths[0] & tied]
    return {
        "kind": row["kind"],
        "colour": experiment["colour"],
        "pushed": experiment["wander"] > 0.0,
        "z": min((one["z"] for one in hidden), default=np.nan),
        "by_two": [*row["left_by_others"], np.nan, np.nan][1],
        "alarm": verdict != "nothing missing",
        "unknown": verdict == "unknown effect",
        "none": not sets,
        "hit": all(hits),
        "alone": all(hits) and not false,
        "wrong": verdict == "explained" and not all(hits),
        "size": min(right or sizes[:1], default=np.nan),
    }


def report(rows: Sequence[Row], salt: str, slow: float) -> str:
    """Tables as markdown, and the failures; above so many seconds a record is too slow."""
    drawn = [row for row in rows if "not_drawn" not in row]
    ran = [row for row in drawn if "found" in row]
    parts = [
        f"Salt {salt}, {len(rows)} records, of which {len(ran)} came to a verdict.",
        _table("bar | wanted | measured (95 % interval) | records", _measured(frame(drawn))),
        _table("end | records", _ends(rows, drawn, slow)),
        _reliability_table(ran),
        _coverage_table(ran),
        "\n".join(failures(rows, slow)),
    ]
    return "\n\n".join(parts)


def _table(head: str, rows: Sequence[Sequence[object]]) -> str:
    titles = head.split(" | ")
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in (titles, ["---"] * len(titles), *rows))


def share(hits: int, count: int) -> str:
    """A share in % with its 95 % interval (Clopper and Pearson)."""
    if not count:
        return "-"
    low, high = binomtest(int(hits), count).proportion_ci(0.95)
    return f"{100 * hits / count:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def _measured(data: pd.DataFrame) -> list[tuple[str, str, str, object]]:
    lines: list[tuple[str, str, str, object]] = []
    for title, wanted, some, what in _bars() if len(data) else ():
        values = data.query(some, engine="python")[what].dropna()
        hits, count = values.sum(), len(values)
        if what != "size":
            lines.append((title, wanted, share(hits, count), f"{hits} of {count}"))
        elif count:
            lines.append((title, wanted, f"{values.mean():.2f} ± {values.sem(ddof=0):.2f}", len(values)))
    return lines


def _ends(rows: Sequence[Row], drawn: Sequence[Row], slow: float) -> list[tuple[str, str]]:
    """Failures and times."""
    late = sum("TooLongError" in row.get("error", "") for row in drawn)
    counts = {
        "internal errors": sum("error" in row for row in drawn) - late,
        "given up": late,
        "errors in the exact fit of the truth": len(rows) - len(drawn),
        "refused with an error of the package": sum("refused" in row for row in drawn),
        "not converged": sum(str(row["found"]["converged"]) != "True" for row in drawn if "found" in row),
    }
    lines = [(title, f"{count} of {len(rows)}") for title, count in counts.items()]
    seconds = pd.Series([row["seconds"] for row in drawn if "seconds" in row])
    if len(seconds):
        middle, most, largest = *seconds.quantile([0.5, 0.95]), seconds.max()
        lines += [
            ("seconds: median, 95 %, slowest", f"{middle:.1f}, {most:.1f}, {largest:.1f}"),
            ("slowest over median (<= 10)", f"{largest / middle:.1f}"),
            (f"over {slow:.0f} s", f"{(seconds > slow).sum()} of {len(seconds)}"),
            ("seconds of drawing, median", f"{np.median([row['drawing'] for row in drawn]):.1f}"),
        ]
    return lines


def reliability(ran: Sequence[Row]) -> list[tuple[float, bool, bool]]:
    """Return for each name its stated probability, whether it is right, and flagged."""
    points = []
    for row in ran:
        if row["kind"].startswith(("effect", "strong", "two", "three")):
            truth = set().union(*(names(one["symbol"]) for one in row["hidden"]))
            for step in row["found"]["steps"]:
                # A force that is written in two ways is one.
                same = sum(q for s, q in step["ties"].items() if names(s) == names(step["symbol"]))
                flagged = row["found"]["verdict"] == "unknown effect"
                points.append((min(1.0, same), step["symbol"] in truth, flagged))
    return points


def _reliability_table(ran: Sequence[Row]) -> str:
    """Names in bins of their stated probability and together, and those that are flagged.

    A name under "unknown effect" is flagged: its probability is among candidates that may all be wrong.
    """
    stated = pd.DataFrame(reliability(ran), columns=["stated", "right", "flagged"])
    bins = pd.cut(stated.stated, EDGES, right=False).where(~stated.flagged.astype(bool))
    groups = [("", part) for _, part in stated.groupby(bins, observed=True)]
    groups += [("all: ", stated[stated.flagged == 0]), ("flagged: ", stated[stated.flagged == 1])]
    rows = []
    for title, part in groups:
        right, count = part.right.sum(), len(part)
        if count:
            rows.append((f"{title}{part.stated.mean():.3f}", share(right, count), f"{right} of {count}"))
    return _table("stated probability of the name, mean | right (95 % interval) | names", rows)


COVERED = (
    "nothing hidden",
    "one effect hidden, its name comes first",
    "one effect hidden, another name or none",
    "truth left out or of no library",
)


def _coverage_table(ran: Sequence[Row]) -> str:
    """95 % intervals of the base coefficients that hold the truth."""
    held = []
    for row in ran:
        pushed, found = "yes" if row["experiment"]["wander"] else "no", row["found"]
        for name, true in row["base"].items() if _covered_kind(row) else ():
            inside = abs(found["base"][name] - true) < 1.96 * found["base_errors"][name]
            held.append((_covered_kind(row), pushed, inside))
    cover = pd.DataFrame(held, columns=["of", "pushed", "holds"])
    counted = cover.groupby(["of", "pushed"]).holds.agg(["sum", "size"])
    rows = [(*names, share(hits, n), f"{hits} of {n}") for names, hits, n in counted.itertuples()]
    return _table("95 % intervals of base coefficients | random force | cover | coefficients", rows)


def _covered_kind(row: Row) -> str:
    if row["kind"].startswith("nothing"):
        return COVERED[0]
    if row["kind"].startswith(("effect", "strong")):
        first = [step["symbol"] for step in row["found"]["steps"]][:1]
        return COVERED[1 if first == [row["hidden"][0]["symbol"]] else 2]
    return COVERED[3] if row["kind"].startswith(("left out", "outside")) else ""


def failures(rows: Sequence[Row], slow: float) -> list[str]:
    """One line for each record that went wrong."""
    lines = []
    for row in sorted(rows, key=lambda row: row["number"]):
        if "not_drawn" in row:
            lines.append(f"NOT DRAWN {row['number']}: {row['not_drawn'].strip().splitlines()[-1]}")
        elif "error" in row or "refused" in row:
            what = row.get("refused") or "ERROR " + row["error"].strip().splitlines()[-1]
            lines.append(f"{_truth(row)} -> {what}")
        elif row["seconds"] > slow or has_failed(row):
            lines.append(f"{_truth(row)} -> {_found(row)}")
    return lines


def has_failed(row: Row) -> bool:
    is_ = _counted(row)
    if row["kind"].startswith("nothing"):
        return is_["alarm"]
    if row["kind"].startswith(("left out", "outside")):
        return not is_["unknown"] and is_["by_two"] >= CLEAR
    return not is_["alone"] or is_["unknown"]


def _truth(row: Row) -> str:
    e, per_period = row["experiment"], 2.0 * np.pi / row["experiment"]["step"]
    seen = {key: e[key] for key in ("starts", "colour", "level", "wander", "stops")} | {"w": row["w"]}
    hidden = [(h["symbol"], h["coefficient"], h["shapes"], f"z={h['z']:.0f}") for h in row["hidden"]]
    return (
        f"{row['number']} {row['kind']} ({per_period:.0f}/period, {e['count'] / per_period:.0f} periods, "
        f"{seen}, {' '.join(row['base'])}): {hidden or 'nothing'} "
        f"left by others {np.round(row['left_by_others'])}"
    )


def _found(row: Row) -> str:
    said = ("coefficient", "ties", "chance", "collinear", "worsens_holdout")
    steps = [{key: step[key] for key in said} for step in row["found"]["steps"]]
    end = f"[{row['found']['verdict']}] failed fits {row['found']['failed_fits']}"
    return f"{steps or 'none'} {end} {row['seconds']:.0f} s"
