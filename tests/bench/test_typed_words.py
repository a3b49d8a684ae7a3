"""What was typed stays typed: an option that is annotated as text holds the word, whatever else it looks like."""

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from calibench.bench.calibration.request import read_calibrate
from calibench.bench.discovery.batch import read_discover
from calibench.bench.execution.request import check_pair, starting_point
from calibench.bench.measured.files import pairs_of
from calibench.bench.sweep.request import read_request
from calibench.bench.sweep.tuner import read_tuning
from calibench.bench.words import RequestError
from calibench.core.options import read_word

pytestmark = pytest.mark.usefixtures("one_process")

MINE = """
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Literal

import numpy as np


class Kind(Enum):
    a = "1.1"
    nan = "1.10"


@dataclass(frozen=True)
class Part:
    tag: str = "x"
    count: int = 3


class Text:
    lower, upper, start = np.full(2, -1.0), np.full(2, 1.0), np.zeros(2)

    def __init__(
        self,
        tag: str = "x",
        data: Path = Path("x"),
        model: Literal["1.1", "1.10", "1e3"] = "1e3",
        maybe: str | None = None,
        either: int | str = 3,
        tags: list[str] = (),
        pair: tuple[str, int] = ("a", 1),
        columns: dict[str, str] = None,
        part: Part = Part(),
        kind: Kind = Kind.a,
        count: int = 3,
        size: float = 1.0,
        any=3,
    ):
        pass

    def __call__(self, x):
        return float(x @ x)
"""
WORDS = ["1.10", "1_000", "1e3", "+7", "007", "true", "null", "yes", "0x10"]
WORDS += ["2024_05_01", "-0", "1.", ".5", "NaN", "inf"]


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    folder = tmp_path_factory.mktemp("typed")
    (folder / "typed_mine.py").write_text(MINE)
    return folder


@pytest.fixture
def options(home, monkeypatch):
    monkeypatch.chdir(home)

    def read(*words):
        asked = ["problem=./typed_mine.py:Text", "optimizer=de", "budget=200", "seeds=1", *words]
        return [dict(spec.problem_options) for spec in read_request(asked, True).specs.values()]

    return read


@pytest.mark.parametrize("option", ["tag", "data", "part.tag"])
def test_text_is_what_was_typed_alone_and_in_a_list(options, option):
    values = [found.get("part", found) for found in options(f"problem.{option}={','.join(WORDS)}")]
    assert [value[option.rpartition(".")[2]] for value in values] == WORDS
    [one] = options(f"prob.Text.{option}=1.10")
    assert one.get("part", one) == {option.rpartition(".")[2]: "1.10"}


def test_a_union_takes_the_first_type_that_a_word_is(options):
    assert options("problem.maybe=1.10,true") == [{"maybe": "1.10"}, {"maybe": "true"}]
    assert options("problem.maybe=null") == [{}]
    assert options("problem.either=1.10,7,0x10") == [{"either": "1.10"}, {"either": 7}, {"either": "0x10"}]


def test_choices_of_text_are_chosen_by_the_word(options):
    assert options("problem.model=1.1,1.10") == [{"model": "1.1"}, {"model": "1.10"}]
    assert options("problem.tag=choice(1.10,1.1)") == [{"tag": "1.10"}, {"tag": "1.1"}]
    assert [options(f"problem.kind={word}") for word in ("1.10", "nan")] == [[{"kind": "1.10"}], [{"kind": "nan"}]]
    for word in ("model=1.20", "kind=1.100"):
        with pytest.raises(ValueError, match=re.escape(f"Text.{word}")):
            options(f"problem.{word}")


def test_text_inside_lists_mappings_and_objects_is_what_was_typed(options):
    assert options("problem.tags=[1.10,'a, b',1e3],[null]") == [{"tags": ["1.10", "a, b", "1e3"]}, {"tags": ["null"]}]
    assert options("problem.pair=[1.10,1_000]") == [{"pair": ["1.10", 1000]}]
    assert options("problem.part={tag: 1.10, count: 1e1}") == [{"part": {"tag": "1.10", "count": 10.0}}]


@pytest.mark.parametrize(
    "written",
    [
        '{enc_1: "Winkel 1"}',
        "{enc_1: Winkel 1}",
        '{"enc_1": "Winkel 1"}',
        "{enc_1:Winkel 1}",
        "{'enc_1':'Winkel 1'}",
        "{ 'enc_1' : Winkel 1 }",
    ],
)
def test_a_mapping_is_read_in_every_spelling_that_a_shell_yaml_or_json_leaves(options, written):
    wanted = {"enc_1": "Winkel 1"}
    assert options(f"problem.columns={written}") == [{"columns": wanted}]
    assert pairs_of("columns", written) == pairs_of("columns", written.strip("{} ")) == wanted
    assert read_word(written) == wanted


def test_names_of_a_mapping_are_any_text(options):
    assert options('problem.columns={"1.10": a, "Länge 2": 1.10, null: b, "c.d": "e, f"}') == [
        {"columns": {"1.10": "a", "Länge 2": "1.10", "null": "b", "c.d": "e, f"}}
    ]
    assert pairs_of("columns", "x:driver's x,y:b's") == {"x": "driver's x", "y": "b's"}


def test_choices_of_a_tuned_option_are_what_was_typed(home, monkeypatch):
    monkeypatch.chdir(home)
    words = ["problem=sensor_zero", "optimizer=./typed_mine.py:Text", "tuner=optuna", "optimizer.tag=1.1,1.10,b"]
    assert read_tuning(words).space[0].choices == ("'1.1'", "'1.10'", "b")


def test_numbers_take_all_their_spellings(options):
    assert options("problem.count=1_000,+7,1e1") == [{"count": 1000}, {"count": 7}, {"count": 10.0}]
    assert options("problem.size=.5,5.,1_0.5") == [{"size": 0.5}, {"size": 5.0}, {"size": 10.5}]
    assert [read_word(word, int) for word in ("1_000", "+7", "007", "1e3")] == [1000, 7, 7, 1000.0]
    assert read_calibrate(["urdf=a", "data=b", "distance=+5_0", "resamples=1e2"]).given.resamples == 100


def test_a_message_has_the_word_as_it_was_typed(options):
    for word in ("'7'", "1.50", "007"):
        with pytest.raises(ValueError, match=re.escape(f"Text.count={word}: ")):
            options(f"problem.count={word}")
    for word in ("budget='100'", "budget=1.50", "target='3'", "time_limit='5'"):
        with pytest.raises(RequestError, match=f"^{word}: "):
            read_request(["problem=sensor_zero", "optimizer=de", word], False)
    with pytest.raises(ValueError, match=r"^distance=0x10: "):
        read_calibrate(["urdf=a", "data=b", "distance=0x10"])


def test_a_scalar_of_a_study_file_is_read_as_if_it_had_been_typed(options, home):
    head = "problem: ./typed_mine.py:Text\noptimizer: de\nbudget: 200\nseeds: 1\n"
    (home / "own.yaml").write_text(
        f"{head}problem.tag: 1.10\nproblem.data: 2024_05_01\nproblem.tags: [1.10, 'a, b']\nproblem.maybe: ~\n"
        "problem.columns: {enc 1: Winkel 1, b: 1.10}\nsweeps:\n  - [problem.model=1.10]\n"
    )
    [spec] = read_request(["study=own.yaml"], False).specs.values()
    assert spec.problem_options == {
        "tag": "1.10",
        "data": "2024_05_01",
        "tags": ["1.10", "a, b"],
        "columns": {"enc 1": "Winkel 1", "b": "1.10"},
        "model": "1.10",
    }


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [x, x]\n" + "".join(f"k{i}: &{chr(98 + i)} [{','.join(9 * ['*' + chr(97 + i)])}]\n" for i in range(9)),
        "a: &a [*a]\n",
        "a: " + 3000 * "[" + 3000 * "]" + "\n",
        "a: " + 300_000 * "x" + "\n",
        "a: 1\na: 2\n",
    ],
)
def test_a_study_file_without_end_is_refused_in_one_line(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.yaml").write_text(f"sweeps: [[problem=full12, optimizer=de]]\n{text}")
    with pytest.raises(RequestError, match=r"^study=own\.yaml: .*"):
        read_request(["study=own.yaml"], False)


def test_options_of_a_machine_are_read_against_their_annotation(tmp_path, monkeypatch):
    (tmp_path / "rig.py").write_text(
        "class Rig:\n    def __init__(self, tag: str = 'x', count: int = 3):\n        pass\n\n"
        "    def formulate(self, data):\n        pass\n"
    )
    monkeypatch.chdir(tmp_path)
    found = read_discover(["machine=./rig.py:Rig", "data=a.csv", "machine.tag=1.10", "machine.count=1_000"])
    assert found.machine_options == {"tag": "1.10", "count": 1000}


@pytest.mark.parametrize("name", [300 * "n", "..", "a/b", "a\x1b[31m", "\ud800"])
@pytest.mark.parametrize(
    ("read", "words"),
    [
        (read_calibrate, ["urdf=a", "data=b"]),
        (read_discover, ["machine=gpm2002", "data=b"]),
        (partial(read_request, multirun=False), ["problem=full12", "optimizer=de"]),
    ],
)
def test_a_study_is_the_name_of_one_folder_for_every_verb(read, words, name):
    with pytest.raises(ValueError, match=r"results=|: holds .* plain text"):
        read([*words, f"study={name}"])


class _Bowl:
    lower, upper = np.array([0.1, 0.1]), np.array([0.3, 1.0])

    def __init__(self, start):
        self.start = np.array(start)

    def __call__(self, x):
        return float(x @ x)


def test_a_start_within_one_rounding_of_its_bound_is_put_on_it():
    from calibench import optimizers

    problem = _Bowl([0.1 + 0.2, np.nextafter(0.1, 0)])
    assert problem.start[0] > problem.upper[0]
    check_pair(problem, optimizers.registry.make("de"))
    assert starting_point(problem, None, "key", 0)[1].tolist() == [0.3, 0.1]
    with pytest.raises(ValueError, match="lies outside its box"):
        check_pair(_Bowl([0.3 + 1e-15, 0.1]), optimizers.registry.make("de"))


def test_no_text_steers_the_terminal(tmp_path, monkeypatch, run_bench):
    (tmp_path / "red.py").write_text(
        "import numpy as np\n\n\nclass Bowl:\n    lower, upper, start = np.zeros(2), np.ones(2), np.ones(2) / 2\n\n"
        "    def __call__(self, x):\n        raise ValueError('\\x1b[31mred\\x07 \\u202e')\n"
    )
    monkeypatch.chdir(tmp_path)
    code, out, err = run_bench("run problem=./red.py:Bowl optimizer=nlopt_LN_BOBYQA budget=20 seeds=1 study=s")
    assert code == 1
    assert r"\x1b[31mred\x07 \u202e" in out + err
    for words in ("status results/s", "report results/s", "show " + _id(tmp_path), "collect results/s"):
        _, more, errors = run_bench(words)
        out, err = out + more, err + errors
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]", out + err)


def _id(folder: Path) -> str:
    import pyarrow.parquet as pq

    return str(pq.ParquetFile(folder / "results" / "s" / "runs.parquet").read()["run_id"][0])


def test_whatever_the_verbs_print_is_printable():
    folder = Path(__file__).parents[2] / "bench" / "commands"
    for file in folder.rglob("*.py"):
        text = file.read_text()
        assert "print_plain as print" in text or not re.search(r"(?<!\w)print\(", text), file
    assert json.dumps("\x1b") == '"\\u001b"'  # which is why --json is safe as it is
