"""Golden records: answers of identify, compare and discover are those that are kept (benchmarks/golden)."""

import pytest

from benchmarks.golden.answers import answer, differences, kept_answers
from benchmarks.golden.cases import CASES

MARKS = {"fast": (), "slow": (pytest.mark.slow,)}


@pytest.mark.parametrize(
    "case", [pytest.param(c, id=c.name, marks=MARKS[c.part]) for c in CASES if c.part in MARKS]
)
def test_answers_are_those_that_are_kept(case):
    if case.needs is not None and not case.needs.is_dir():
        pytest.skip(f"no records in {case.needs}; set SYSID_TRIB_DATA to the folder `data` beside it")
    assert differences(kept_answers()[case.name], answer(case)) == []
