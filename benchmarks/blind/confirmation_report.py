"""What the confirmation set says, against the bars: shares with 95 % binomial intervals, and each failure."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from .scoring import names

Row = dict[str, Any]
# Bins of z, of the truth's least visible effect.
BINS = {"8-12": (8.0, 12.0), "12-20": (12.0, 20.0), "> 20": (20.0, np.inf)}
# z that the best two others leave, above which the record cannot be explained without the truth.
CLEAR = 20.0
# Seconds above which a record is too slow, where the direct identification of commit 2d1a9b1 takes 77 ms.
SLOW = 60.0
# In the place of what is found where an error ended the search.
FAILED = {"verdict": "none", "steps": []}
# Edges of stated probabilities in the reliability diagram.
EDGES = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0])


def report(rows: Sequence[Row], salt: str, figure: Path, slow: float = SLOW) -> str:
    """Tables as markdown, and the failures; the reliability diagram goes into `figure`.

    `slow` : seconds above which a record is too slow on the machine of the rows.
    """
    drawn = [row for row in rows if "not_drawn" not in row]
    ran = [row for row in drawn if "found" in row]
    # A record without a verdict is a miss in every share that it belongs to.
    counted = [row if "found" in row else row | {"found": FAILED} for row in drawn]
    # A name under "unknown effect" is flagged: its probability is among candidates that may all be wrong.
    points, flagged = (reliability([row for row in ran if is_unknown(row) == told]) for told in (False, True))
    parts = [
        f"Salt {salt}, {len(rows)} records, of which {len(ran)} came to a verdict.",
        _bars(counted),
        _ends(rows, drawn, slow),
        _reliability_table(points, flagged),
        _coverage_table(ran),
        "\n".join(failures(rows, slow)),
    ]
    if points:
        draw(points, figure)
        parts.insert(4, f"Figure: {figure.name}")
    return "\n\n".join(parts)


def share(hits: int, count: int) -> str:
    """A share in % with its 95 % interval (Clopper and Pearson)."""
    if not count:
        return "-"
    low, high = binomtest(hits, count).proportion_ci(0.95)
    return f"{100 * hits / count:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def hits_of(row: Row) -> list[bool]:
    """Of each hidden effect, whether it is in the set of a step."""
    return [any(names(one["symbol"]) & {*ties} for ties in sets_of(row)) for one in row["hidden"]]


def sets_of(row: Row) -> list[dict[str, float]]:
    return [step["ties"] for step in row["found"]["steps"]]


def false_sets(row: Row) -> int:
    """Steps whose set holds none of the hidden effects."""
    truth = set().union(*(names(one["symbol"]) for one in row["hidden"]))
    return sum(not truth & {*ties} for ties in sets_of(row))


def is_unknown(row: Row) -> bool:
    return bool(row["found"]["verdict"] == "unknown effect")


def named_wrongly(row: Row) -> bool:
    """Explained, and a hidden effect is in no set."""
    return row["found"]["verdict"] == "explained" and not all(hits_of(row))


def is_alarm(row: Row) -> bool:
    return bool(row["found"]["verdict"] != "nothing missing")


def pushed(row: Row) -> bool:
    return bool(row["experiment"]["wander"] > 0.0)


def least_z(row: Row) -> float:
    return min(one["z"] for one in row["hidden"])


def set_size(row: Row) -> int:
    """Size of the set that holds the truth, chance with it, or of the first."""
    truth = names(row["hidden"][0]["symbol"])
    sizes = [
        (len(s["ties"]) + (s["chance"] > 0.0), bool(truth & {*s["ties"]})) for s in row["found"]["steps"]
    ]
    return min([size for size, right in sizes if right] or [sizes[0][0]])


def _bars(ran: list[Row]) -> str:
    lines = ["| bar | wanted | measured (95 % interval) | records |", "| --- | --- | --- | --- |"]

    def add(title: str, wanted: str, some: list[Row], of: Callable[[Row], bool]) -> None:
        hits = sum(map(of, some))
        lines.append(f"| {title} | {wanted} | {share(hits, len(some))} | {hits} of {len(some)} |")

    def only(*kinds: str) -> list[Row]:
        return [row for row in ran if row["kind"].startswith(kinds)]

    nothing = only("nothing")
    for kind, wanted in (("white", "<= 2 %"), ("coloured", "<= 3 %"), ("quantised", "<= 4 %")):
        some = [row for row in nothing if row["kind"].endswith(kind) and not pushed(row)]
        add(f"false alarms, {kind}", wanted, some, is_alarm)
    for colour in ("ar1", "ar2", "pink"):
        add(
            f"of these, {colour}",
            "",
            [r for r in nothing if r["experiment"]["colour"] == colour and not pushed(r)],
            is_alarm,
        )
    add("false alarms, random force", "<= 2 %", [row for row in nothing if pushed(row)], is_alarm)
    for colour in ("white", "ar1", "ar2", "pink", "quantised"):
        add(
            f"of these, {colour}",
            "",
            [r for r in nothing if r["experiment"]["colour"] == colour and pushed(r)],
            is_alarm,
        )
    single = only("effect", "strong")
    for name, (low, high) in BINS.items():
        some = [row for row in single if low <= least_z(row) < high]
        add(f"truth in the 95 % set, z {name}", "93 to 99 %", some, lambda row: all(hits_of(row)))
        for title, wander in (("without a random force", False), ("with one", True)):
            part = [row for row in some if pushed(row) == wander]
            add(f"of these, {title}", "", part, lambda row: all(hits_of(row)))
        with_names = [row for row in some if row["found"]["steps"]]
        if with_names:
            sizes = [set_size(row) for row in with_names]
            error = np.std(sizes) / np.sqrt(len(sizes))
            lines.append(
                f"| mean size of the set, z {name} | | {np.mean(sizes):.2f} ± {error:.2f} | {len(sizes)} |"
            )
    seen = [row for row in single if least_z(row) >= BINS["8-12"][0]]
    add("nothing named, z > 8", "", seen, lambda row: not row["found"]["steps"])
    add("named wrongly and not flagged, z > 8", "<= 1.5 %", seen, named_wrongly)
    add("unknown said, truth among the candidates, z > 8", "", seen, is_unknown)
    for title, kinds in (("left out", ("left out",)), ("of no library", ("outside",))):
        clear = [row for row in only(*kinds) if row["left_by_others"][1] >= CLEAR]
        add(f"unknown said, truth {title}, two others leave z >= 20", ">= 97 %", clear, is_unknown)
        rest = [row for row in only(*kinds) if row["left_by_others"][1] < CLEAR]
        add(f"unknown said, truth {title}, two others leave less", "", rest, is_unknown)
    strong = only("strong")
    add("strong effects: truth in its set", ">= 90 %", strong, lambda row: all(hits_of(row)))
    add(
        "strong effects: and no second named",
        ">= 90 %",
        strong,
        lambda row: all(hits_of(row)) and not false_sets(row),
    )
    for kind, wanted in (("two", ">= 90 %"), ("three", ">= 75 %")):
        some = [row for row in only(kind) if least_z(row) >= BINS["8-12"][0]]
        add(f"{kind} hidden: each in a set", "", some, lambda row: all(hits_of(row)))
        add(
            f"{kind} hidden: each in a set, none besides",
            wanted,
            some,
            lambda row: all(hits_of(row)) and not false_sets(row),
        )
    return "\n".join(lines)


def _ends(rows: Sequence[Row], drawn: Sequence[Row], slow: float) -> str:
    """Failures and times."""
    lines = ["| end | records |", "| --- | --- |"]
    late = sum("TooLongError" in row.get("error", "") for row in drawn)
    errors = sum("error" in row for row in drawn) - late
    for title, count in (
        ("internal errors", errors),
        ("given up", late),
        ("errors in the exact fit of the truth", len(rows) - len(drawn)),
        ("refused with an error of the package", sum("refused" in row for row in drawn)),
        ("not converged", sum(row["found"]["converged"] != "True" for row in drawn if "found" in row)),
    ):
        lines.append(f"| {title} | {count} of {len(rows)} |")
    seconds = np.array([row["seconds"] for row in drawn if "seconds" in row])
    if len(seconds):
        median = float(np.median(seconds))
        lines.append(
            f"| seconds: median, 95 %, slowest | {median:.1f}, {np.quantile(seconds, 0.95):.1f}, "
            f"{seconds.max():.1f} |"
        )
        lines.append(f"| slowest over median (<= 10) | {seconds.max() / median:.1f} |")
        lines.append(f"| over {slow:.0f} s | {int(np.sum(seconds > slow))} of {len(seconds)} |")
        drawing = np.median([row["drawing"] for row in drawn if "drawing" in row])
        lines.append(f"| seconds of drawing, median | {drawing:.1f} |")
    return "\n".join(lines)


def reliability(ran: Sequence[Row]) -> list[tuple[float, bool]]:
    """Stated probability of each name, and whether it is right; where the truth is among the candidates."""
    points = []
    for row in ran:
        if row["kind"].startswith(("effect", "strong", "two", "three")):
            truth = set().union(*(names(one["symbol"]) for one in row["hidden"]))
            for step in row["found"]["steps"]:
                # A force that is written in two ways is one.
                same = sum(q for s, q in step["ties"].items() if names(s) == names(step["symbol"]))
                points.append((min(1.0, same), step["symbol"] in truth))
    return points


def _binned(points: Sequence[tuple[float, bool]]) -> list[tuple[float, int, int]]:
    """Of each bin of stated probability: its mean, right ones, all."""
    stated, right = np.array([p for p, _ in points]), np.array([q for _, q in points])
    at = np.clip(np.searchsorted(EDGES, stated, side="right") - 1, 0, len(EDGES) - 2)
    return [
        (float(stated[at == i].mean()), int(right[at == i].sum()), int(np.sum(at == i)))
        for i in range(len(EDGES) - 1)
        if np.any(at == i)
    ]


def _reliability_table(points: Sequence[tuple[float, bool]], flagged: Sequence[tuple[float, bool]]) -> str:
    """Of names that are not flagged in bins of their probability and together, and of those that are."""
    if not points:
        return "No names."
    lines = [
        "| stated probability of the name, mean | right (95 % interval) | names |",
        "| --- | --- | --- |",
    ]
    lines += [_reliability_line("", row) for row in _binned(points)]
    for title, some in (("all: ", points), ("flagged: ", flagged)):
        if some:
            whole = float(np.mean([p for p, _ in some])), sum(q for _, q in some), len(some)
            lines.append(_reliability_line(title, whole))
    return "\n".join(lines)


def _reliability_line(title: str, row: tuple[float, int, int]) -> str:
    stated, hits, count = row
    return f"| {title}{stated:.3f} | {share(hits, count)} | {hits} of {count} |"


def draw(points: Sequence[tuple[float, bool]], figure: Path) -> None:
    """Share of names that are right over their stated probability."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    found = _binned(points)
    stated, right = [q for q, _, _ in found], np.array([hits / count for _, hits, count in found])
    limits = np.array([binomtest(hits, count).proportion_ci(0.95)[:] for _, hits, count in found])
    fig, ax = plt.subplots(figsize=(4.5, 4.5), layout="constrained")
    ax.plot([0, 1], [0, 1], color="0.7", zorder=0)
    ax.errorbar(stated, right, np.abs(limits.T - right), fmt="o", capsize=3)
    ax.set(xlabel="stated probability of the name", ylabel="share of names that are right")
    ax.set(xlim=(0, 1.02), ylim=(0, 1.02))
    fig.savefig(figure, dpi=150)


def _coverage_table(ran: Sequence[Row]) -> str:
    """95 % intervals of the base coefficients that hold the truth."""
    lines = [
        "| 95 % intervals of base coefficients | random force | cover | coefficients |",
        "| --- | --- | --- | --- |",
    ]

    def is_first(row: Row) -> bool:
        return (
            bool(row["found"]["steps"]) and row["found"]["steps"][0]["symbol"] == row["hidden"][0]["symbol"]
        )

    for title, kinds, of in (
        ("nothing hidden", ("nothing",), lambda row: True),
        ("one effect hidden, its name comes first", ("effect", "strong"), is_first),
        ("one effect hidden, another name or none", ("effect", "strong"), lambda row: not is_first(row)),
        ("truth left out or of no library", ("left out", "outside"), lambda row: True),
    ):
        for wander in (False, True):
            of_kind = [row for row in ran if row["kind"].startswith(kinds) and pushed(row) == wander]
            some = [row for row in of_kind if of(row)]
            cover = [
                abs(row["found"]["base"][name] - true) < 1.96 * row["found"]["base_errors"][name]
                for row in some
                for name, true in row["base"].items()
            ]
            hits, count, force = sum(cover), len(cover), "yes" if wander else "no"
            lines.append(f"| {title} | {force} | {share(hits, count)} | {hits} of {count} |")
    return "\n".join(lines)


def failures(rows: Sequence[Row], slow: float = SLOW) -> list[str]:
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
    if row["kind"].startswith("nothing"):
        return is_alarm(row)
    if row["kind"].startswith(("left out", "outside")):
        return not is_unknown(row) and row["left_by_others"][1] >= CLEAR
    return not all(hits_of(row)) or is_unknown(row) or bool(false_sets(row))


def _truth(row: Row) -> str:
    e = row["experiment"]
    hidden = ", ".join(
        f"{h['symbol']} {h['coefficient']:.2g}{_numbers(h['shapes'])} z={h['z']:.0f} "
        f"f={h['relative_force']:.3f}"
        for h in row["hidden"]
    )
    per_period, start = 2.0 * np.pi / e["step"], e["starts"][0]
    return (
        f"{row['number']} {row['kind']} ({len(e['starts'])} run, {e['colour']}, {per_period:.0f}/period, "
        f"{e['count'] / per_period:.0f} periods, A={start:.2g}, noise {e['level'] / start:.1e}, "
        f"wander {e['wander']:.1f}, w={row['w']:.2g}{', stops' * e['stops']}; {' '.join(row['base'])}): "
        f"{hidden or 'nothing'}{_left(row)}"
    )


def _left(row: Row) -> str:
    return (
        " left by others " + "/".join(f"{q:.0f}" for q in row["left_by_others"])
        if row["left_by_others"]
        else ""
    )


def _numbers(values: dict[str, float]) -> str:
    return "".join(f" {k}={q:.2g}" for k, q in values.items())


def _found(row: Row) -> str:
    steps = "; ".join(
        f"{s['coefficient']:.2g} "
        + " ".join(f"{k}:{q:.2f}" for k, q in s["ties"].items())
        + f" chance:{s['chance']:.2f}" * (s["chance"] > 0.0)
        + " collinear" * s["collinear"]
        + " fit only" * s["worsens_holdout"]
        for s in row["found"]["steps"]
    )
    failed = row["found"]["failed_fits"]
    text = f" failed fits {' '.join(failed)}" * bool(failed)
    return f"{steps or 'none'} [{row['found']['verdict']}]{text} {row['seconds']:.0f} s"
