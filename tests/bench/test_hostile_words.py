"""Whatever is typed after `bench`: an answer or one line, in bounded time and memory, and never a traceback."""

import contextlib
import io
import os
import resource

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import calibench
from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.commands import paper
from calibench.bench.sweep.request import read_request
from calibench.bench.sweep.words import MOST_RUNS
from calibench.core.options import coerce, shown
from calibench.core.words import DEEPEST, LONGEST_WORD, check_word, one_line

pytestmark = pytest.mark.usefixtures("one_process", "undrawn")

RUN = ["problem=sensor_zero", "optimizer=de", "budget=10", "--dry-run"]
DEEP = "[" * 20_000 + "]" * 20_000
HUGE = "9" * 20


def said(*words):
    """Return the exit code and what was printed."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told), pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code, told.getvalue()


@pytest.fixture(autouse=True)
def somewhere_else(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield
    assert os.listdir(tmp_path) == []  # a request that is wrong, or that only asks, writes nothing


def refused(*words):
    code, line = said(*words)
    assert code == 2
    assert line.startswith("bench: ")
    assert line.count("\n") == 1
    assert len(line) < 1000
    assert line.strip().isprintable()
    return line


WORDS = {
    "nested": ("=" + DEEP, "20000 deep"),
    "braces": ("=" + "{a:" * 5000 + "1" + "}" * 5000, "5000 deep"),
    "references": ("=" + "${" * 3000 + "}" * 3000, "3000 deep"),
    "long": ("=" + "x" * 200_000, "has 200"),
    "escape": ("=\x1b[31m", "control character '\\x1b'"),
    "nul": ("=a\0b", "control character '\\x00'"),
    "surrogate": ("=\ud800", "no UTF-8"),
    "bytes": ("=caf\udce9.csv", "no UTF-8"),
}
VERBS = [
    ["run", "problem.x"],
    ["run", "budget"],
    ["run", "seeds"],
    ["run", "study"],
    ["run", "results"],
    ["discover", "data"],
    ["discover", "sigma_enc"],
    ["design", "plan.n"],
    ["identify", "problem"],
    ["paper", "budget"],
    ["show", "results"],
    ["status", "a"],
    ["collect", "a"],
    ["report", "a"],
    ["list", "a"],
]


@pytest.mark.parametrize("kind", WORDS)
@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_no_verb_reads_a_word_that_is_no_plain_text(verb, kind):
    word, told = WORDS[kind]
    assert told in refused(verb[0], verb[1] + word)


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("budget=" + HUGE, "at most 2e+09"),
        ("budget=1e300", "at most 2e+09"),
        ("budget=" + "9" * 400, "at most 2e+09"),
        ("budget=" + "9" * 5000, "cannot be read"),
        ("seeds=0:1000000000000", f"at most {MOST_RUNS}"),
        (f"seeds={HUGE}", f"at most {2**63 - 1}"),
        (f"seeds={HUGE}:{HUGE}9", f"at most {2**63 - 1}"),
        ("time_limit=1e300", "at most 1e+09"),
        ("target=" + "9" * 400, "a number is needed"),
        (f"problem.data_seed={HUGE}", f"at most {2**63 - 1}"),
        ("problem.n=10000000000", "at most 1000000 configurations"),
        ("problem.n=1e20", f"at most {2**63 - 1}"),
        (f"optimizer.population={HUGE}", f"at most {2**63 - 1}"),
        ("problem.free=" + "[" * DEEPEST + "]" * DEEPEST, "a word is needed"),
        ("start=" + "[" * DEEPEST + "]" * DEEPEST, "choices: nominal, random"),
        ("study=a\nb", "the name of one folder"),
    ],
    ids=lambda word: word[:30],
)
def test_a_value_beyond_all_measure_is_one_line(word, told):
    key = word.partition("=")[0]
    assert told in refused("run", word, *(other for other in RUN if other.partition("=")[0] != key))


def test_more_processes_than_a_machine_has_are_not_started():
    assert "at most 1024" in refused("run", *RUN, "execution=processes", "execution.n_jobs=100000000")
    words = ("machine=gpm2002", "data=a.csv", "execution=processes", "execution.n_jobs=100000000")
    assert "at most 1024" in refused("discover", *words)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["budget=range(1,1000000000000)"], "999999999999 values"),
        (["problem.noise=range(0,1,1e-12)"], "1000000000000"),
        (["problem.data_seed=range(0,9000)", "problem.n=range(10,20)"], "10000 settings of problems"),
        (["budget=range(10,9010)", "target=range(1,200)", "seeds=1"], f"at most {MOST_RUNS}"),
    ],
    ids=["a range", "a range of fractions", "lists of options", "lists of cells"],
)
def test_a_sweep_without_end_is_counted_and_not_made(words, told):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    keys = {word.partition("=")[0] for word in words}
    assert told in refused("run", "-m", *words, *(word for word in RUN if word.partition("=")[0] not in keys))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


def test_a_deterministic_method_runs_once_whatever_the_seeds():
    words = ["problem=sensor_zero", "optimizer=lm", "budget=10", "seeds=0:1000000000000"]
    request = read_request(words, multirun=False)
    assert len(request.specs) == 1


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("plan=disc plan.n=99999999999999999999", f"at most {2**63 - 1}"),
        ("plan=disc plan.n=100000000", "100000 readings"),
        ("plan=disc plan.n=0", "100000 readings"),
        ("plan=disc plan.without=5", "a list is needed"),
        ("plan=disc plan.machine=5", "names with values"),
        ("plan=disc plan.branches=[1]", "a sign for each"),
        ('plan=disc plan.machine={"la1":1e300}', "at most 1e+06 mm"),
        ("plan=disc plan.seed=-1", "0 or above"),
        ("plan=disc size=1e300", "from 1e-06 to 1e+06"),
        ("plan=disc size=1e-300", "from 1e-06 to 1e+06"),
        ("data=demo_nothing sigma_enc=1e-300", "from 1e-15"),
        ("data=demo_nothing sigma_enc=1e300", "from 1e-15"),
        ("data=demo_nothing fixed_parameters=[[1]]", "names '[1]'"),
        ("data=demo_nothing tooth_numbers=1e300", "joints"),
        ('data=demo_nothing nominal={"la1":' + "9" * 400 + "}", "a finite number is needed"),
    ],
    ids=lambda words: words[:50],
)
def test_what_a_design_cannot_be_is_one_line(words, told):
    assert told in refused("design", "machine=gpm2002", *words.split())


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ('nominal={"drho_x":{"a":1}}', "a finite number"),
        ('nominal={"drho_x":1e300}', "at most 1e+09"),
        ("data.moving_weight_N=[]", "a finite number"),
        ('data.gravity="a"', "three numbers"),
        ("data.gravity=[1e300,0,0]", "at most 1e+09"),
        ("sigma=1e-300", "from 1e-15"),
        ("free=[[1]]", "choices: auto"),
    ],
)
def test_what_is_stated_of_an_orthoglide_is_what_it_must_be(word, told):
    assert told in refused("design", "machine=orthoglide", "data=exp1", word)


def test_a_list_of_files_may_be_longer_than_the_name_of_one():
    many = ",".join(f"folder/run{i}.csv" for i in range(2000))
    assert "there is no such file" in refused("design", "machine=gpm2002", "data=folder/run0.csv")
    assert "names 2000 sets" in refused("design", "machine=gpm2002", f"data={many}")


def test_a_budget_of_the_paper_is_read_before_anything_runs():
    for budget in (HUGE, "²", "1.5", "-1"):
        refused("paper", f"budget={budget}")
    assert "seeds=x" in refused("paper", "seeds=x")


def test_what_python_is_given_is_refused_alike():
    problem, lm = problems.make("sensor_zero"), optimizers.make("lm")
    for wrong in ({"budget": 10**30}, {"seed": 10**30}, {"target": 10**400}, {"time_limit": 1e300}):
        with pytest.raises(ValueError, match=next(iter(wrong))) as caught:
            bench.execute(problem, lm, **{"budget": 10, "seed": 0} | wrong)
        assert len(str(caught.value)) < 500
    with pytest.raises(ValueError, match=r"problem\.x=: brackets stand 20000 deep"):
        calibench.sweep("problem=sensor_zero", "optimizer=lm", "problem.x=" + DEEP)


def test_a_value_of_the_environment_passes_the_same_door(monkeypatch):
    monkeypatch.setenv("NESTED", "[" * 99)
    assert "99 deep" in refused("run", "problem.free=${oc.env:NESTED}", *RUN)


def test_a_message_shows_a_list_that_holds_itself():
    endless = [1]
    endless.append(endless)
    for kind in (float, tuple[float, ...]):
        with pytest.raises(ValueError, match=r"a=\[1"):
            coerce("a", endless, kind)
    assert shown(list(range(100))).endswith("18,19,…]")
    assert shown({"a": {"b": np.pi}}) == f"{{a: {{b: {np.pi}}}}}"


def test_a_message_is_one_line_that_no_terminal_obeys():
    assert one_line("a\n\tb \x1b[2J \ud800") == "a b \\x1b[2J \\ud800"
    assert len(one_line("x" * 100_000)) == 301
    assert len(one_line("word " * 100_000)) <= 8_001


def test_what_the_door_lets_in_no_parser_chokes_on():
    deepest = [
        "[" * DEEPEST + "]" * DEEPEST,
        "{a:" * DEEPEST + "1" + "}" * DEEPEST,
        "(" * DEEPEST + "1" + ")" * DEEPEST,
    ]
    for value in (*deepest, "${" * DEEPEST + "}" * DEEPEST, "'" * 999, "\\" * 999, ",".join("1" * 999)):
        check_word(f"a={value}")
        for key in ("problem.free", "budget"):
            refused("run", f"{key}={value}", *(word for word in RUN if word.partition("=")[0] != key))


def test_a_list_is_parsed_up_to_a_length():
    assert "has 40014 characters" in refused("run", "problem.free=" + "1," * 20_000 + "1", *RUN)


@pytest.mark.parametrize("key", ["budget", "problem.n", "seeds", "execution", "target"])
def test_a_glob_is_of_names(key):
    told = refused("run", "-m", f"{key}=glob(*)", *(word for word in RUN if word.partition("=")[0] != key))
    assert "glob(" in told


def test_no_word_is_longer_than_the_longest():
    check_word("x" * LONGEST_WORD)
    with pytest.raises(ValueError, match="has 100001 characters"):
        check_word("x" * (LONGEST_WORD + 1))


KEYS = st.sampled_from(
    [
        "problem",
        "problem.n",
        "problem.free",
        "problem.readings",
        "optimizer",
        "optimizer.population",
        "budget",
        "seeds",
        "opt.de.population",
        "start",
        "target",
        "time_limit",
        "study",
        "execution",
        "execution.n_jobs",
        "results",
        "machine",
        "data",
        "sigma_enc",
        "tooth_numbers",
        "nominal",
        "plan",
        "plan.n",
        "plan.radius",
        "size",
        "next",
        "rivals",
        "noise",
    ]
)
VALUES = st.one_of(
    st.text(max_size=30),
    st.integers().map(str),
    st.floats().map(repr),
    st.just(HUGE),
    st.just(DEEP[:50]),
    st.text(alphabet="[](){},:.'\"\\$~*?!=0123abc-+e ", max_size=30),
    st.sampled_from(["full12", "lm", "de", "gpm2002", "orthoglide", "disc", "ci", "exp1", "null", "true", "glob(*)"]),
)
TYPED = st.one_of(
    st.builds("{}={}".format, KEYS, VALUES),
    st.text(max_size=20),
    st.sampled_from(["--json", "--all", "-m", "--keep", "--rerun", "-h", "--retry", "problems"]),
)
VERB = st.sampled_from(
    [
        "list",
        "run",
        "identify",
        "discover",
        "design",
        "show",
        "status",
        "collect",
        "report",
        "paper",
        "merge",
        "compare",
    ]
)


def no_ledger(*_args):
    raise ValueError("the papers are not rerun here")


@pytest.mark.slow
@settings(deadline=None, max_examples=150)
@given(VERB, st.lists(TYPED, max_size=4))
def test_any_words_end_with_an_answer_or_one_line(tmp_path_factory, verb, words):
    always = {
        "run": RUN,
        "identify": ["problem=sensor_zero"],
        "discover": ["machine=gpm2002", "data=nowhere.csv"],  # no search: only words are asked here
        "design": ["machine=gpm2002", "data=nowhere.csv"],
    }
    given_keys = {word.partition("=")[0] for word in words}
    more = [word for word in always.get(verb, []) if word.partition("=")[0] not in given_keys]
    searches = verb in ("discover", "design") and "data" in given_keys
    words = [word for word in words if not (searches and word.startswith(("data=", "plan=")))]
    folder = tmp_path_factory.getbasetemp() / "typed"
    folder.mkdir(exist_ok=True)
    with contextlib.chdir(folder), pytest.MonkeyPatch.context() as patched:
        patched.setattr(paper, "run_paper", no_ledger)
        code, told = said(verb, *words, *more)
    assert code in (0, 1, 2)
    assert "Traceback" not in told
    assert code == 0 or told.count("\n") <= 3


@pytest.mark.parametrize(
    "fault", [RecursionError("maximum recursion depth"), OverflowError("too large"), MemoryError()]
)
def test_what_no_door_expected_is_still_one_line_that_says_where(monkeypatch, fault):
    def identify(*_args, **_options):
        raise fault

    monkeypatch.setattr("calibench.problems.identify", identify)
    line = refused("identify", "problem=sensor_zero")
    assert type(fault).__name__ in line
    assert "test_hostile_words.py, line " in line
