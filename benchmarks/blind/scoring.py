"""Scores of the blind tests against their bars."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

Row = dict[str, Any]
STRENGTHS = ("8-20", "20-60", "60-300", ">300")
SIZES = {"8-20": 3.5, "20-60": 2.3, "60-300": 1.3}
# Bouc-Wen hysteresis with n = 1 is Dahl's, its coefficient over b.
SAME = ({"dahl", "bouc_wen"},)
# Above this z a remaining residual is not by chance.
CLEAR = 30.0


def classes(row: Row) -> list[list[str]]:
    """Tie class of every step."""
    return [step["ties"] for step in row["found"]["steps"]]


def names(truth: str) -> set[str]:
    """The truth's symbols: one force may be written in two ways."""
    return next((same for same in SAME if truth in same), {truth})


def hit(row: Row) -> bool:
    """Whether every hidden effect is in the tie class of a step."""
    return all(any(names(one["symbol"]) & {*ties} for ties in classes(row)) for one in row["hidden"])


def size(row: Row) -> int:
    """Size of the class that holds the truth, or of the first."""
    truth = names(row["hidden"][0]["symbol"])
    return min([len(ties) for ties in classes(row) if truth & {*ties}] or [len(classes(row)[0])])


def family_right(row: Row) -> bool:
    """Whether the first named is of the truth's family, or the truth is among its ties."""
    truth = row["hidden"][0]
    return hit(row) or any(step["family"] == truth["family"] for step in row["found"]["steps"])


def named_wrongly(row: Row) -> bool:
    return row["found"]["verdict"] == "explained" and not hit(row)


def covered(row: Row) -> bool | None:
    """Whether the 95 % interval of a coefficient holds the truth, if its effect is named."""
    truth = row["hidden"][0]
    for step in row["found"]["steps"]:
        if step["symbol"] == truth["symbol"] and len(row["found"]["steps"]) == 1:
            return bool(abs(step["coefficient"] - truth["coefficient"]) < 1.96 * step["standard_error"])
    return None


def _share(rows: Iterable[Row], of: Callable[[Row], bool | None]) -> tuple[float, int, int]:
    found = [value for value in map(of, rows) if value is not None]
    return (float(np.mean(found)) if found else np.nan), int(sum(found)), len(found)


def table(rows: list[Row]) -> str:
    """The bars and what was measured, as markdown, with the failures."""
    ran = [row for row in rows if "found" in row]
    lines = ["| bar | wanted | measured | records |", "| --- | --- | --- | --- |"]

    def share(title: str, wanted: str, some: list[Row], of: Callable[[Row], bool | None]) -> None:
        value, hits, count = _share(some, of)
        if count:
            lines.append(f"| {title} | {wanted} | {100 * value:.1f} % | {hits} of {count} |")

    def only(start: str) -> list[Row]:
        return [row for row in ran if row["kind"].startswith(start)]

    for name, most in (("white", 3), ("coloured", 6), ("quantised", 6)):
        share(f"false alarms, {name}", f"<= {most} %", only(f"nothing {name}"), _alarm)
    for kind in ("ar1", "ar2", "pink"):
        some = [row for row in only("nothing coloured") if row["colour"] == kind]
        share(f"false alarms, {kind}", "", some, _alarm)
    for name in STRENGTHS:
        some = only(f"effect {name}")
        share(f"truth in the tie class, z {name}", ">= 90 %" if name == ">300" else ">= 93 %", some, hit)
        named = [row for row in some if row["found"]["steps"]]
        if named:
            wanted = f"<= {SIZES[name]}" if name in SIZES else ""
            mean = np.mean([size(row) for row in named])
            lines.append(f"| mean class size, z {name} | {wanted} | {mean:.2f} | {len(named)} |")
    effects = only("effect")
    share("nothing named", "", effects, lambda row: not row["found"]["steps"])
    share("verdict unknown effect, truth in the library", "", effects, _unknown)
    share("family right", ">= 97 %", effects, family_right)
    share("named wrongly", "<= 1 %", effects, named_wrongly)
    share("95 % interval covers", "90 to 98 %", effects, covered)
    for runs in (1, 2):
        some = [row for row in effects if row["runs"] == runs]
        share(f"truth in the tie class, {runs} run(s)", "", some, hit)
    clear = [row for row in effects if abs(row["hidden"][0]["z"]) >= CLEAR and hit(row)]
    gaps = [row["found"]["gap"] for row in clear if np.isfinite(row["found"]["gap"])]
    if gaps:
        low, middle, high = 100 * np.quantile(gaps, [0.05, 0.5, 0.95])
        lines.append(
            f"| hold-out residual above the noise | <= 2 % | {middle:.2f} % "
            f"({low:.2f} to {high:.2f}) | {len(gaps)} |"
        )
    for z, least in ((20, 65), (60, 97), (200, 97)):
        share(
            f"unknown effect said, truth removed from the library, z {z}",
            f">= {least} %",
            only(f"left out {z}"),
            _unknown,
        )
    strong = [row for row in only("left out") if row["beyond"][0] >= 20.0]
    share("the same, where the best other candidate has z >= 20 unexplained", "", strong, _unknown)
    strong = [row for row in only("left out") if row["beyond"][1] >= 20.0]
    share("the same, where the best two others have z >= 20 unexplained", "", strong, _unknown)
    share("unknown effect said, of no library", ">= 97 %", only("outside"), _unknown)
    share("two effects both named", ">= 85 %", only("two"), hit)
    if ran:
        lines.append(
            f"| seconds a record (drawing) | | {np.median([r['seconds'] for r in ran]):.2f} "
            f"({np.median([r['drawing'] for r in ran]):.2f}) | {len(ran)} |"
        )
    return "\n".join([*lines, "", *failures(rows)])


def _alarm(row: Row) -> bool:
    return row["found"]["verdict"] != "nothing missing"


def _unknown(row: Row) -> bool:
    return row["found"]["verdict"] == "unknown effect"


def failures(rows: list[Row]) -> list[str]:
    """One line for each case that went wrong."""
    found = []
    for row in sorted(rows, key=lambda row: (row["kind"], row["key"])):
        if "unseen" in row:
            found.append(f"unseen: {row['unseen']}")
        elif "error" in row:
            found.append(f"ERROR {row['key']} {row['hidden']}: {row['error'].strip().splitlines()[-1]}")
        elif _failed(row):
            found.append(_line(row))
    return found


def _failed(row: Row) -> bool:
    if row["kind"].startswith("nothing"):
        return _alarm(row)
    if row["kind"].startswith(("left out", "outside")):
        return not _unknown(row)
    return not hit(row) or _unknown(row)


def _line(row: Row) -> str:
    def number(values: dict[str, float]) -> str:
        return " ".join(f"{k}={q:.3g}" for k, q in values.items())

    truth = ", ".join(
        f"{h['symbol']} {h['coefficient']:.2g} {number(h['shapes'])} z={h['z']:.0f}" for h in row["hidden"]
    )
    steps = "; ".join(f"{s['coefficient']:.2g} {' = '.join(s['ties'])}" for s in row["found"]["steps"])
    beyond = f" beyond {'/'.join(f'{q:.0f}' for q in row['beyond'])}" if row["beyond"] else ""
    setting = f"{row['runs']} run, {row['colour']}, A={row['start']:.2f}, base {' '.join(row['base'])}"
    return (
        f"{row['key']} ({setting}): "
        f"{truth or 'nothing'}{beyond} -> {steps or 'none'} [{row['found']['verdict']}]"
    )
