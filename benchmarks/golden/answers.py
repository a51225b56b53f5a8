"""Results of commands as compact data, and the differences between two such results."""

import contextlib
import json
import shlex
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from command_line import run

from benchmarks.golden.cases import Case

GOLDEN = Path(__file__).parents[2] / "tests" / "golden"
# Values within so much of their errors, and errors of each other.
SAME_VALUE, SAME_ERROR = 0.1, 0.05
# P-values on the same side.
LEVEL, RESIDUAL_LEVEL = 0.01, 1e-3
Answer = dict[str, Any]


def answer(case: Case) -> Answer:
    """Words, p-values, and values with their errors."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        case.write(Path(folder))
        ended = run(*shlex.split(case.command), "--json")
    return _compact(json.loads(ended.out)) if ended.status == 0 else {"words": {"status": ended.status}}


def _compact(found: Mapping[str, Any]) -> Answer:
    words = {key: found[key] for key in ("verdict", "search_outcome", "answer", "best") if key in found}
    values: dict[str, Any] = {}
    p_values: dict[str, Any] = {}
    models = found.get("methods") or {"model": found.get("model")}
    for name, method in models.items():
        words |= {f"{name} {key}": bool(method[key]) for key in ("failed", "failure") if key in method}
        values |= dict(_values(name, method))
        p_values |= {f"{name} hold-out": method[k] for k in ("holdout_p_value",) if k in method}
    if found.get("random_force"):
        words["pushed"] = True
    check = found.get("cross_check") or {}
    words |= {f"cross-check {key}": check[key] for key in ("verdict", "errors") if key in check}
    p_values |= {"cross-check": check["p_value"]} if "p_value" in check else {}
    judged = found["judged"] if "answer" in found else {}
    p_values |= {f"{name} residual": model["p_value"] for name, model in judged.items()}
    for number, step in enumerate(found.get("steps", ())):
        words[f"step {number}"] = step["symbol"]
        words[f"beside step {number}"] = sorted(one["symbol"] for one in step["indistinguishable_from"])
        p_values[f"step {number}"] = step["p_value"]
    if "omnibus" in found:
        p_values |= {"omnibus": found["omnibus"]["p_value"], "noise_p_value": found["noise_p_value"]}
    return {"words": words, "values": values, "p": {k: _rounded(v) for k, v in p_values.items()}}


def _values(name: str, method: Mapping[str, Any]) -> Iterator[tuple[str, list[float | None]]]:
    for symbol, each in method["coefficients"].items():
        yield f"{name} {symbol}", [_rounded(each["value"]), _rounded(each["standard_error"])]
    for key in ("reference_frequency", "asymptotic_frequency"):
        if key in method:
            pair = [_rounded(method[key]), _rounded(method.get(f"{key}_standard_error"))]
            yield f"{name} {key}", pair


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")


def differences(kept: Answer, found: Answer) -> list[str]:
    """Return the differences of a result from the kept one; empty if both are the same."""
    said = [*kept["words"], *(word for word in found["words"] if word not in kept["words"])]
    wrong = [
        f"{word}: {kept['words'].get(word)!r}, now {found['words'].get(word)!r}"
        for word in said
        if kept["words"].get(word) != found["words"].get(word)
    ]
    for part, same in (("values", _same_value), ("p", _same_side)):
        old, new = kept.get(part, {}), found.get(part, {})
        wrong += [f"{name}: only once" for name in old.keys() ^ new.keys()]
        wrong += [
            f"{name}: {old[name]}, now {new[name]}"
            for name in old.keys() & new.keys()
            if not same(name, old[name], new[name])
        ]
    return wrong


def _same_value(name: str, old: list[float | None], new: list[float | None]) -> bool:
    if None in old or None in new:
        return old == new
    (value, error), (other, others) = np.array(old, float), np.array(new, float)
    # What is held has no error.
    near = abs(other - value) <= max(SAME_VALUE * error, 1e-5 * abs(value))
    return bool(near and abs(others - error) <= SAME_ERROR * error)


def _same_side(name: str, old: float | None, new: float | None) -> bool:
    if old is None or new is None:
        return old == new
    level = RESIDUAL_LEVEL if name.endswith("residual") else LEVEL
    return (old < level) == (new < level)


def kept_answers() -> dict[str, Answer]:
    """All golden answers by the names of their cases."""
    return {
        name: found
        for path in sorted(GOLDEN.glob("*.json"))
        for name, found in json.loads(path.read_text(encoding="utf-8")).items()
    }


def keep(answers: Mapping[str, Answer]) -> None:
    """Write answers, a line each, into the file of their group; others there stay."""
    GOLDEN.mkdir(exist_ok=True)
    whole = {**kept_answers(), **answers}
    for group in sorted({name.partition(" ")[0] for name in whole}):
        lines = [
            f"{json.dumps(name, ensure_ascii=False)}: {json.dumps(whole[name], ensure_ascii=False)}"
            for name in sorted(whole)
            if name.partition(" ")[0] == group
        ]
        (GOLDEN / f"{group}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
