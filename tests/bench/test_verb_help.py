"""`bench VERB --help`: the usage of that verb alone, and every word that it reads."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest

from calibench.bench import verbs
from calibench.bench.cli import _VERBS, main
from calibench.bench.sweep import composition
from calibench.bench.words import Word, help_of, keys_of, read
from calibench.discrepancy.registries import description_of

DECLARED = {
    "calibrate": [verbs.CalibrateWords, verbs.HandEyeWords],
    "design": [verbs.PosesWords, verbs.DesignWords],
    "discover": [verbs.DiscoverWords],
    "identify": [verbs.IdentifyWords],
    "paper": [verbs.PaperWords],
    "choose": [verbs.ChooseWords],
    "compare": [verbs.CompareWords],
    "show": [verbs.TrackingWords],
    "history": [verbs.HistoryWords],
    "run": [verbs.TunerWords],
}
READ = {verb: {key for cls in classes for key in keys_of(cls)} for verb, classes in DECLARED.items()}
READ["run"] |= {*composition.KEYS, "execution", "execution.n_jobs", "problem.dh", "problem.convention"}


@pytest.fixture
def told(capsys):
    def call(*words):
        with pytest.raises(SystemExit) as ended:
            main(list(words))
        assert ended.value.code == 0
        return capsys.readouterr().out

    return call


@pytest.mark.parametrize("verb", list(_VERBS))
def test_the_help_of_a_verb_is_its_own(told, verb):
    text = told(verb, "--help")
    heads = [line.split()[2] for line in text.splitlines() if line.startswith("usage: bench ")]
    assert heads
    assert all(verb in head.split("|") for head in heads)
    assert text == told(verb, "-h") == told("help", verb)
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize("verb", list(READ))
def test_the_help_of_a_verb_has_every_word_that_it_reads(told, verb):
    text = told(verb, "--help")
    there = set(re.findall(r"^  ([\w.]+)=", text, re.MULTILINE))
    assert READ[verb] <= there, READ[verb] - there


@dataclass(frozen=True)
class Draw:
    urdf: Annotated[Path, Word("urdf", "my.urdf", "the arm's description")]
    count: Annotated[int, Word("plan.n", "12", "how many", least=1, most=50)] = 4
    by: Annotated[Literal["D", "E"], Word("by", "D|E", "what is cared for")] = "D"


def test_a_request_of_a_verb_is_read_as_it_is_declared():
    assert read(Draw, "draw", ["plan.n=7", "urdf=a b.urdf"]) == Draw(Path("a b.urdf"), 7)
    assert help_of(Draw) == {
        "urdf=my.urdf": "the arm's description", "plan.n=12": "how many (4)", "by=D|E": "what is cared for (D)",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "urdf= is missing: the arm's description, such as urdf=my.urdf"),
        (["urdf=a", "plan.n=51"], "plan.n=51: a whole number from 1 to 50 is needed"),
        (["urdf=a", "plan.n=many"], "plan.n=many: a whole number from 1 to 50 is needed"),
        (["urdf=a", "by=F"], "by=F: choices: D, E"),
        (["urdf=a", "plan.m=5"], "draw: unknown argument 'plan.m'; did you mean 'plan.n'?"),
        (["urdf=a", "urdf=b"], "urdf is given twice"),
        (["urdf="], "urdf needs a value, such as urdf=my.urdf"),
    ],
)
def test_what_no_declaration_allows_is_refused_in_one_line(words, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        read(Draw, "draw", words)


def test_what_may_be_stated_of_an_arm_is_in_the_help_of_discover(told):
    text = told("discover", "--help")
    stated = {one.key for one in description_of("arm").stated}
    assert not {key for key in stated if f"{key}=" not in text}


def test_the_overview_has_every_verb_and_says_where_its_words_are(told):
    text = told("--help")
    assert "bench VERB --help" in text
    assert all(re.search(rf"^  (\w+\|)?{verb}\b", text, re.MULTILINE) for verb in _VERBS)


def test_help_on_a_verb_there_is_not_says_so(capsys):
    """`bench help discovr` gave the overview, and exit 0."""
    with pytest.raises(SystemExit) as ended:
        main(["help", "discovr"])
    assert ended.value.code == 2
    assert "did you mean 'discover'" in capsys.readouterr().err
