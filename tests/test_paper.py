"""The paper for a journal: its numbers stand in the documentation, its citations in its bibliography."""

import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
PAPER = ROOT / "paper" / "paper.md"
if not PAPER.exists():
    pytest.skip("the paper is not in this package", allow_module_level=True)

_, HEAD, BODY = PAPER.read_text(encoding="utf-8").split("---\n", 2)
BIBLIOGRAPHY = (ROOT / "paper" / "paper.bib").read_text(encoding="utf-8")
SOURCE = re.compile(r"<!-- (\S+): (.+?) -->")
NUMBER = re.compile(r"(?<![\w.-])(?:\d{1,3}(?:,\d{3})+|\d+)(?:\.\d+)?(?!\w|\.\d)")
# Sections that the journal requires, and ours.
SECTIONS = [
    "Summary",
    "Statement of need",
    "State of the field",
    "Software design",
    "Research impact statement",
    "Limitations",
    "Acknowledgements",
    "References",
]


def prose(text):
    """A text without comments, formulas, code, citations and numbers of lists."""
    text = re.sub(r"<!--.*?-->|\$\$?.*?\$\$?|`.*?`|\[@.*?\]", " ", text, flags=re.DOTALL)
    return re.sub(r"^\d+\. ", "", text, flags=re.MULTILINE)


def figures():
    """Numbers of the paper with their source: (numbers, file, command)."""
    # Between two comments stands the text that the second one covers, back to the beginning of its section.
    for section in re.split(r"^#+ .+$", BODY, flags=re.MULTILINE):
        *parts, rest = re.split(r"(<!-- \S+: .+? -->)", section)
        for text, comment in zip(parts[::2], parts[1::2], strict=True):
            file, command = SOURCE.fullmatch(comment).groups()
            yield pytest.param(text, file, command, id=f"{file}: {' '.join(prose(text).split())[:30]}")
        yield pytest.param(rest, None, None, id=f"no source: {' '.join(prose(rest).split())[:30]}")


@pytest.mark.parametrize(("text", "file", "command"), list(figures()))
def test_every_number_was_measured(text, file, command):
    numbers = set(NUMBER.findall(prose(text)))
    if file is None:
        # The level of an interval is no result.
        assert numbers <= {"95"}
        return
    source = (ROOT / file).read_text(encoding="utf-8")
    assert numbers
    assert numbers - set(NUMBER.findall(source)) == set()
    assert command in source


def test_a_changed_number_would_be_noticed():
    text, file, command = next(case.values for case in figures() if case.values[1] == "docs/arena.md")
    with pytest.raises(AssertionError):
        test_every_number_was_measured(text.replace("14.8", "13.8"), file, command)


def test_every_citation_has_an_entry_and_every_entry_is_cited():
    cited = {key for group in re.findall(r"\[(@.+?)\]", BODY) for key in re.findall(r"@(\w+)", group)}
    entries = re.findall(r"^@\w+\{(\w+),$", BIBLIOGRAPHY, re.MULTILINE)
    assert len(entries) == len(set(entries))
    assert cited == set(entries)


def test_entries_are_whole():
    for entry in re.split(r"\n\n+", BIBLIOGRAPHY.strip()):
        keys = re.findall(r"^  (\w+) = \{.*\},$", entry, re.MULTILINE)
        assert {"author", "title", "year"} <= set(keys), entry
        assert {"journal", "booktitle", "publisher", "howpublished", "url"} & set(keys), entry
        assert len(keys) == entry.count("\n") - 1, entry
    dois = re.findall(r"^  doi = \{(.*)\},$", BIBLIOGRAPHY, re.MULTILINE)
    assert len(dois) == len(set(dois)) > 10
    assert all(re.fullmatch(r"10\.\d{4,9}/\S+", doi) for doi in dois)


def test_the_form_is_that_of_the_journal():
    head = yaml.safe_load(HEAD)
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= set(head)
    indices = {place["index"] for place in head["affiliations"]}
    assert {author["affiliation"] for author in head["authors"]} <= indices
    assert re.findall(r"^# (.+)$", BODY, re.MULTILINE) == SECTIONS
    assert 750 <= len(re.sub(r"<!--.*?-->", "", BODY, flags=re.DOTALL).split()) <= 1750
