"""What is typed after `bench`: text is taken to the letter, what is given twice or not known is refused in one line."""

import json

import pytest

from calibench import optimizers
from calibench.bench.cli import main
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.composition import compose, last_value, parse, values_of
from calibench.bench.sweep.request import read_request
from calibench.bench.words import RequestError

pytestmark = pytest.mark.usefixtures("one_process")

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
    composed = compose([f"{o.key_or_group}={values_of(o)[0]}" for o in overrides if o.key_or_group != "study"])
    assert (composed["results"], composed["problem"]["readings"]) == (text, text)


@pytest.mark.parametrize(("kind", "typed", "values"), [("int", "5,6", [5, 6]), ("str", "a,1.10", ["a", "1.10"])])
def test_readings_of_a_class_are_what_it_declares(tmp_path, monkeypatch, kind, typed, values):
    """A word is the path of a file where the option is declared as one, whatever the option is called."""
    monkeypatch.chdir(tmp_path)
    start = "lower, upper, start = [-1.0], [1.0], [0.0]"
    (tmp_path / f"reads_{kind}.py").write_text(
        f"class Mine:\n    {start}\n\n    def __init__(self, readings: {kind} = {values[0]!r}):\n"
        "        self.readings = readings\n\n    def __call__(self, x):\n        return float(x[0] ** 2)\n"
    )
    words = [f"problem=./reads_{kind}.py:Mine", f"problem.readings={typed}", "optimizer=de", "budget=9", "seeds=1"]
    asked = [spec.problem_options for spec in read_request(words, multirun=True).specs.values()]
    assert [options.get("readings", values[0]) for options in asked] == values


def test_quotes_around_a_path_are_not_of_it():
    assert last_value(parse(["results='a b'"]), "results", "") == "a b"


@pytest.mark.parametrize(
    ("typed", "values"),
    [
        ("1/c²", ["1/c²"]),
        ("dätä λ/t.csv", ["dätä λ/t.csv"]),
        ("1/c, 1/c²", ["1/c", "1/c²"]),
        ("'5 µg','a, µ'", ["5 µg", "a, µ"]),
        ("[1,λ]", [[1, "λ"]]),
        ("{dose: {route: börus, n: 3}}", [{"dose": {"route": "börus", "n": 3}}]),
    ],
)
def test_letters_beyond_ascii_need_no_quotes(typed, values):
    [override] = parse([f"problem.readings_of={typed}"])
    read = [parse([f"problem.x={text}"])[0].value() for text in values_of(override)]
    plain = [json.loads(json.dumps(value, default=lambda quoted: quoted.text)) for value in read]
    assert plain == values


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
    with pytest.raises(RequestError, match="brackets, braces and quotes") as refused:
        parse(["seeds=3", argument])
    told = str(refused.value)
    assert told.startswith(f"{argument}: ")
    quoted = told.rpartition(": ")[2].strip('"')
    assert parse([quoted])[0].value() == argument.partition("=")[2]  # what it proposes can be read


def test_an_option_as_the_tables_call_it_is_told_with_both_of_its_words(call, tmp_path):
    code, _, err = call("run", "problem=sensor_zero", "optimizer=de", "opt.population=8", f"results={tmp_path}")
    assert code == 2
    assert "optimizer.population= is that of every optimizer, opt.NAME.population= of one" in err


@pytest.mark.parametrize("argument", ["=3", "a b=3", "é=3"])
def test_a_key_that_cannot_be_one_is_unknown(argument):
    with pytest.raises(RequestError, match="unknown argument"):
        parse([argument])


def test_the_environment_is_read_where_it_is_asked_for(call, tmp_path, monkeypatch):
    monkeypatch.setenv("WHERE", "a b")
    monkeypatch.setenv("HOW_MANY", "7")
    words = ["run", "problem=sensor_zero", "optimizer=de", "budget=${oc.env:HOW_MANY}", "seeds=${oc.env:NONE,2}"]
    assert call(*words, "results=${oc.env:WHERE}/c")[0] == 0
    runs = ResultStore(tmp_path / "a b" / "c" / "adhoc").runs()
    assert runs["budget"].tolist() == [7, 7]
    assert [path.name for path in tmp_path.iterdir()] == ["a b"]


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("results=${oc.env:NOT_SET_HERE}", "the environment variable NOT_SET_HERE is not set"),
        ("study=${oc.env:NOT_SET_HERE}", "the environment variable NOT_SET_HERE is not set"),
        ("budget=${oc.env:NOT_SET_HERE}", "the environment variable NOT_SET_HERE is not set"),
        ("results=${oc.decode:3}", "${oc.decode:3} cannot be resolved here"),
    ],
)
def test_what_the_environment_has_not_is_refused_and_no_folder_of_that_name_made(call, tmp_path, word, told):
    given = [w for w in ("budget=5", "seeds=1") if w.partition("=")[0] != word.partition("=")[0]]
    code, out, err = call("run", "problem=sensor_zero", "optimizer=de", *given, word)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert told in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("typed", "values"),
    [
        ("range(.3,.9,.2)", [".3", ".5", ".7"]),
        ("range(.9,.3,-.2)", [".9", ".7", ".5"]),
        ("range(0,1,.1)", [f".{i}" for i in range(10)]),
        ("range(1e-9,4e-9,1e-9)", ["1e-9", "2e-9", "3e-9"]),
        ("range(1,10,3)", ["1", "4", "7"]),
        ("sort(range(.1,.4,.1),reverse=true)", [".3", ".2", ".1"]),
    ],
)
def test_a_range_is_the_decimals_that_were_typed(typed, values):
    found = values_of(parse([f"problem.x={typed}"])[0])
    assert [float(text) for text in found] == [float(text) for text in values]
    assert max(map(len, found)) <= 5


@pytest.mark.parametrize(
    ("typed", "told"), [("range(0.,1.,0.)", "a step other than 0"), ("interval(0,1)", "an interval is no list")]
)
def test_a_sweep_that_is_no_list_is_refused(typed, told):
    with pytest.raises(RequestError, match=told):
        values_of(parse([f"problem.x={typed}"])[0])


def test_a_name_and_a_glob_stand_in_one_list():
    request = read_request(["problem=sensor_zero", "optimizer=lm,glob([de,do*]),de", "budget=5", "seeds=1"], True)
    assert [spec.optimizer for spec in request.specs.values()] == ["lm", "de", "dogbox"]
    with pytest.raises(RequestError, match="matches no optimizer"):
        read_request(["problem=sensor_zero", "optimizer=lm,glob(none_*)", "budget=5", "seeds=1"], True)


PLAIN = """
import numpy as np
class Plain:
    lower, upper, start = -np.ones(2), np.ones(2), np.ones(2) / 2
    def __call__(self, x): return float(x @ x)
"""


@pytest.fixture
def plain(tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("own")
    (folder / "plain_words.py").write_text(PLAIN)
    monkeypatch.syspath_prepend(str(folder))
    return "plain_words:Plain"


def test_what_a_glob_leaves_out_is_told_before_the_runs(call, plain):
    words = ["optimizer=glob([lm,trf,dogbox,de])", "budget=5", "seeds=1"]
    _, out, _ = call("run", "-m", f"problem={plain}", *words)
    assert out.splitlines()[0] == "lm, trf, dogbox need residuals: skipped"
    _, out, _ = call("run", "-m", f"problem={plain},sensor_zero", *words, "--dry-run")
    assert out.splitlines()[0] == f"lm, trf, dogbox need residuals: skipped on {plain}"
    code, out, err = call("run", f"problem={plain}", "optimizer=glob(l*)", "budget=5", "seeds=1", "-m")
    assert (code, out) == (2, "")
    assert "nothing to run" in err
    assert "lm needs residuals: skipped" in err


OPEN = """
import numpy as np
class Open:
    lower, upper, start = np.array([-1.0, 0.0]), np.array([1.0, np.inf]), np.ones(2) / 2
    def residuals(self, x): return x - 0.3
    def __call__(self, x): return float(np.sum((x - 0.3) ** 2))
"""


def test_what_needs_finite_bounds_is_left_out_of_a_glob_and_refused_by_name(call, tmp_path):
    (tmp_path / "ajar.py").write_text(OPEN)
    words = ["problem=./ajar.py:Open", "budget=20", "seeds=1"]
    code, out, _ = call("run", "-m", *words, "optimizer=glob([lm,trf,de,fmincon,nlopt_LN_COBYLA])")
    assert code == 0
    assert out.splitlines()[0] == "de, nlopt_LN_COBYLA need finite bounds: skipped"
    assert "failed" not in out
    code, out, err = call("run", *words, "optimizer=de")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "de needs finite bounds, and problem ajar.py:Open has upper[1]=inf; give it two ends" in err


def test_of_many_methods_that_a_glob_leaves_out_the_number_is_told(tmp_path):
    (tmp_path / "wide_open.py").write_text(OPEN)
    request = read_request([f"problem={tmp_path}/wide_open.py:Open", "optimizer=glob(*)", "budget=20", "seeds=1"], True)
    [told] = [line for line in request.left_out if "finite bounds" in line]
    number, _, rest = told.partition(" ")
    assert int(number) > 8
    assert rest == (
        "methods that the glob matches (`bench list optimizers` has the traits of each) need finite bounds: skipped"
    )


def test_errors_of_failed_runs_have_the_room_of_the_terminal(call, tmp_path, monkeypatch):
    words = " ".join(f"word{k}" for k in range(40))
    bad = f"class Bad(Open):\n    def residuals(self, x): raise ValueError({words!r})\n"
    (tmp_path / "talkative.py").write_text(OPEN + bad)
    ask = ["problem=./talkative.py:Bad", "budget=20", "seeds=1", "optimizer=lm"]
    monkeypatch.setenv("COLUMNS", "60")
    assert "word9" in (narrow := call("run", *ask)[1])
    assert "word39" not in narrow
    monkeypatch.setenv("COLUMNS", "500")
    assert "word39" in call("run", *ask, "study=wide")[1]


def test_a_glob_takes_what_may_loop_for_ever_with_a_time_limit_only(plain):
    def chosen(*words):
        request = read_request([f"problem={plain}", *words, "budget=50", "seeds=1"], True)
        return {spec.optimizer for spec in request.specs.values()}, request.left_out

    hangs, told = "nlopt_LN_NEWUOA_BOUND", "needs time_limit=SECONDS, as it may loop for ever: skipped"
    assert chosen("optimizer=glob(nlopt_LN_NEWUOA*)") == ({"nlopt_LN_NEWUOA"}, (f"{hangs} {told}",))
    assert chosen("optimizer=glob(nlopt_LN_NEWUOA*)", "time_limit=9") == ({"nlopt_LN_NEWUOA", hangs}, ())
    assert chosen(f"optimizer={hangs}") == ({hangs}, ()), "named, it is run"


def test_a_method_that_is_named_and_cannot_run_is_refused_also_beside_a_glob(call, plain, tmp_path):
    code, out, err = call("run", "-m", f"problem={plain}", "optimizer=lm,glob(d*)", "budget=5", "seeds=1")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "lm needs residuals" in err
    assert not list(tmp_path.iterdir())


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


def test_a_misspelt_option_of_a_machine_is_told_with_those_that_this_machine_reads(call):
    code, _, err = call("discover", "machine=mount", "data=demo_flexure", "sgima=1")
    assert code == 2
    assert "sigma_arcsec" in err
    assert "tooth_numbers" not in err


def test_a_name_that_is_left_out_is_told_with_its_own_reason_whatever_its_words(monkeypatch):
    monkeypatch.setattr(optimizers.registry, "_left_out", {"blocked": "its licence is unknown"})
    with pytest.raises(ValueError, match="'blocked' is left out: its licence is unknown"):
        read_request(["problem=sensor_zero", "optimizer=blocked", "budget=10"], False)
    with pytest.raises(ValueError, match="unknown optimizer 'blockd'"):
        read_request(["problem=sensor_zero", "optimizer=blockd", "budget=10"], False)
