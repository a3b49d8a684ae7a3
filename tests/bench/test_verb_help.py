"""`bench VERB --help`: the usage of that verb alone, and every word that it reads."""

import re

import pytest

from calibench.bench.calibration import design as plan
from calibench.bench.calibration import hand_eye
from calibench.bench.calibration import request as calibrate
from calibench.bench.cli import _VERBS, main
from calibench.bench.discovery import request as discovery
from calibench.bench.sweep import composition as hydra_overrides
from calibench.bench.sweep import tuner as space
from calibench.discrepancy.registries import description_of

ARM = {"machine.dh", "machine.convention", "machine.urdf", "machine.base", "machine.tip"}
READ = {
    "calibrate": {*calibrate._KEYS, *hand_eye._KEYS},
    "design": {*plan._KEYS, *discovery._DESIGN},
    "discover": {*discovery._PLAIN, *discovery._OF_COLUMNS, *ARM},
    "run": {*hydra_overrides._KEYS, *space._WORDS, "execution", "execution.n_jobs", "problem.dh", "problem.convention"},
}


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
    there = set(re.findall(r"^  ([\w.]+)=", text, re.MULTILINE)) | set(re.findall(r"\b(tuner)=optuna", text))
    assert READ[verb] <= there, READ[verb] - there


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
