"""docs/words.md tells each word in one plain line, and tells none that nobody uses."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "words.md"
LINES = [line for line in PAGE.read_text().splitlines() if line.startswith("- ")]
ENTRY = re.compile(r"- \*\*([^*]+)\*\*: (.+[.])$")
ROOMS = ("core", "calibration", "problems", "optimizers", "discrepancy", "bench", "benchmarks", "docs")
TEXTS = [
    " ".join(path.read_text().split()).lower()
    for path in [ROOT / "README.md", *(p for room in ROOMS for p in (ROOT / room).rglob("*.*"))]
    if path.suffix in (".py", ".md", ".yaml") and path != PAGE
]


def words() -> list[str]:
    return [found[1] for line in LINES if (found := ENTRY.match(line))]


@pytest.mark.parametrize("line", LINES)
def test_a_word_is_told_in_one_plain_line(line: str) -> None:
    found = ENTRY.match(line)
    assert found is not None, "- **word**: one sentence."
    assert len(line) <= 132
    assert not re.search(r"[.] [A-Z]", found[2])  # one sentence


@pytest.mark.parametrize("word", words())
def test_a_word_that_is_told_is_used(word: str) -> None:
    spelt = re.compile(rf"\b{re.escape(word.lower())}s?\b")
    assert any(spelt.search(text) for text in TEXTS)


def test_words_are_told_once_and_are_not_few() -> None:
    told = words()
    assert len(told) == len(set(told)) == len(LINES) >= 25


def test_a_word_that_nobody_uses_would_be_found() -> None:
    assert not any(re.search(r"\bflabbergasters\b", text) for text in TEXTS)
