"""What is typed after `bench`: text is taken to the letter, what is given twice or not known is refused in one line."""

import json

import pytest

from bench.cli import main
from bench.overrides import compose, last_value, parse
from bench.request_values import RequestError

NASTY = [
    "${x}",
    r"\${x}",
    r"\\${oc.env:HOME}",
    r"a\b",
    "a'b",
    'a"b',
    "a b, c",
    "tail\\",
    "tail\\\\",
    r"a\'b",
    "$x",
    "{[(=",
]


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def run(*words):
        with pytest.raises(SystemExit) as ended:
            main(list(words))
        told = capsys.readouterr()
        return ended.value.code, told.out, told.err

    return run


@pytest.mark.parametrize("text", NASTY)
def test_a_path_is_taken_to_the_letter(text):
    overrides = parse([f"results={text}", f"study={text}", "problem=full12", f"problem.readings={text}"])
    assert last_value(overrides, "study", "") == text
    composed = compose([o for o in overrides if o.key_or_group != "study"])
    assert (composed["results"], composed["problem"]["readings"]) == (text, text)


def test_quotes_around_a_path_are_not_of_it():
    assert last_value(parse(["results='a b'"]), "results", "") == "a b"


def test_results_go_where_the_words_say(call, tmp_path):
    code, *_ = call(
        "run", "problem=sensor_zero", "optimizer=de", "budget=5", "seeds=1", "results=${HOME}", "study=${s}"
    )
    assert code == 0
    assert (tmp_path / "${HOME}" / "${s}" / "runs.parquet").exists()


@pytest.mark.parametrize(
    "words",
    [
        ["run", "problem=full12", "optimizer=de", "seeds=3", "seeds=5"],
        ["run", "problem=full12", "problem.n=30", "optimizer=de", "problem.n=40"],
        ["run", "problem=full12", "problem=full11", "optimizer=de"],
        ["identify", "problem=full12", "noise=1", "noise=2"],
        ["identify", "problem=full12", "problem.n=30", "problem.n=40"],
        ["show", "abc", "results=a", "results=b"],
        ["paper", "--budget", "ci", "budget=paper"],
    ],
)
def test_what_is_given_twice_is_refused(call, tmp_path, words):
    code, out, err = call(*words)
    assert (code, out) == (2, "")
    assert "is given twice" in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("word", ["nois=1", "full12", "optimizer=de", "problems=full12", "noise=", "noise=loud"])
def test_identify_refuses_what_it_does_not_know(call, word):
    code, out, err = call("identify", "problem=full12", word)
    assert (code, out) == (2, "")
    assert word.partition("=")[0] in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "argument", ["problem.n=[3", "optimizer=de{", "problem=full12'", "problem.n==3", "target=a,,b"]
)
def test_a_value_that_cannot_be_read_is_named_with_the_way_out(argument):
    with pytest.raises(RequestError, match="cannot be read: brackets, braces and quotes must match") as refused:
        parse(["seeds=3", argument])
    told = str(refused.value)
    assert told.startswith(f"{argument}: ")
    quoted = told.rpartition(": ")[2].strip('"')
    assert parse([quoted])[0].value() == argument.partition("=")[2]  # what it proposes can be read


@pytest.mark.parametrize("argument", ["=3", "a b=3", "é=3"])
def test_a_key_that_cannot_be_one_is_unknown(argument):
    with pytest.raises(RequestError, match="unknown argument"):
        parse([argument])


def test_json_of_a_run_is_json(call):
    call("run", "problem=full12", "optimizer=de", "budget=5", "seeds=1")
    code, out, _ = call("show", "", "--json")
    assert code == 0
    assert json.loads(out, parse_constant=pytest.fail)["target"] is None


@pytest.mark.parametrize("words", [["list", kind] for kind in ("problems", "optimizers", "studies", "figures")])
def test_json_of_a_list_is_json(call, words):
    json.loads(call(*words, "--json")[1], parse_constant=pytest.fail)


def test_json_of_an_identification_is_json(call):
    assert json.loads(call("identify", "problem=full12", "--json")[1], parse_constant=pytest.fail)["rank"] == 11
