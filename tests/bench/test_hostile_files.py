"""Measured data that no reader can take: each is one line, at once, and the files beside it are answered."""

import contextlib
import gzip
import io
import os
import resource
import socket
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from calibench import problems
from calibench.bench.cli import main
from calibench.bench.measured import files, read_measured, shipped_path, write_measured
from calibench.core.tables import data_file
from calibench.core.tables.csv_table import read_table
from calibench.core.tables.data_file import LARGEST_PARQUET, LARGEST_TEXT, MOST_CELLS, MOST_COLUMNS, read_whole
from calibench.discrepancy import DataError

DEEP = "[" * 100_000 + "]" * 100_000
ALIKE = pa.DictionaryArray.from_arrays(np.zeros(40, np.int32), [bytes(8_000_000)])  # 8 MB, and 320 MB when read
MEMORY = 300_000_000  # bytes above what is there before: no file below may take as much


def said(*words):
    """Return the exit code and what was printed."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told), pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code, told.getvalue()


@contextlib.contextmanager
def at_most(more):
    """Let this process have so many bytes more; beyond them it is a MemoryError."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + more, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a socket's path must be short
    return tmp_path


def a_socket(path):
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(path)


def sparse(path, size):
    with open(path, "wb") as file:
        file.truncate(size)


def with_metadata(path, metadata):
    schema = pa.schema([("enc_1", pa.float64())], metadata={"measured_data": metadata})
    pq.write_table(pa.table([[1.0]], schema=schema), path)


def beside(path, text):
    with open(path.replace(".csv", ".json"), "w") as file:
        file.write(text)
    written(path, "enc_1\n1\n")


def written(path, text):
    with open(path, "wb") as file:
        file.write(text if isinstance(text, bytes) else text.encode())


def table(path, columns, **how):
    pq.write_table(pa.table(columns), path, **how)


HOSTILE = {
    "pipe.csv": (os.mkfifo, "is a pipe, and a file is needed"),
    "pipe.parquet": (os.mkfifo, "is a pipe, and a file is needed"),
    "socket.csv": (a_socket, "is a socket"),
    "zero.csv": (lambda path: os.symlink("/dev/zero", path), "is a device"),
    "zero.parquet": (lambda path: os.symlink("/dev/zero", path), "is a device"),
    "folder.csv": (os.mkdir, "is a folder, and a file is needed"),
    "loop.csv": (lambda path: os.symlink(path, path), "symbolic links"),
    "gone.csv": (lambda path: os.symlink("nowhere", path), "there is no such file"),
    "ten_gigabytes.csv": (lambda path: sparse(path, 10**10), "10000 MB, and at most 100 MB are read; write it"),
    "ten_gigabytes.parquet": (lambda path: sparse(path, 10**10), "10000 MB, and at most 500 MB are read; take part"),
    "million.csv": (lambda path: written(path, "a," * 10**6 + "a\n"), f"1000001 columns, and at most {MOST_COLUMNS}"),
    "line.csv": (lambda path: written(path, "enc_1\n" + "," * (MOST_CELLS + 1)), f"at most {MOST_CELLS} are read"),
    "lines.csv": (lambda path: written(path, "enc_1\n" + "\n" * (MOST_CELLS + 1)), f"at most {MOST_CELLS} are read"),
    "letters.csv": (lambda path: written(path, "enc_1" + "x" * 10**7), "field larger than field limit"),
    "spaces.csv": (lambda path: written(path, "enc_1" + " " * 100_000 + "]\n1\n"), "a name, or a name with its unit"),
    "wide_cell.csv": (lambda path: written(path, "split\n" + "x" * 10**5 + "\na" * 2000), "has 100000 characters"),
    "nul.csv": (lambda path: written(path, "enc_1\n1\0\n"), "NUL bytes"),
    "packed.csv": (lambda path: written(path, gzip.compress(b"enc_1\n1\n")), "is packed (gzip); unpack it first"),
    "other.csv": (lambda path: table(path, {"enc_1": [1.0]}), "let its name end in .parquet"),
    "text.parquet": (lambda path: written(path, "enc_1\n1\n"), "no Parquet file that can be read"),
    "wide.parquet": (
        lambda path: table(path, {f"c{i}": [1.0] for i in range(3000)}), f"3000 columns, and at most {MOST_COLUMNS}"
    ),
    "footer.parquet": (
        lambda path: written(path, b"PAR1" + bytes(9_000_000) + (9_000_000).to_bytes(4, "little") + b"PAR1"),
        "9 MB that tell of its columns, and at most 8 MB",
    ),
    "word.parquet": (
        lambda path: table(path, {"split": pa.DictionaryArray.from_arrays(np.zeros(2000, np.int32), ["x" * 10**5])}),
        "has 100000 characters",
    ),
    "list.in.parquet": (
        lambda path: table(path, {"enc_1": pa.ListArray.from_arrays([0, 40], ALIKE)}, store_schema=False),
        "it holds list",
    ),
    "many.parquet": (lambda path: table(path, {"enc_1": np.zeros(60_000_000, np.int8)}), "60000000 rows of 1 columns"),
    "deep.csv": (lambda path: written(path, f"# measured_data: {DEEP}\nenc_1\n1\n"), "100000 deep in each other"),
    "deep.parquet": (lambda path: with_metadata(path, DEEP), "100000 deep in each other"),
    "deep_beside.csv": (lambda path: beside(path, DEEP), "deep_beside.json: brackets stand 100000 deep"),
    "large_beside.csv": (lambda path: beside(path, " " * 2_000_000), "large_beside.json beside it: has 2 MB"),
    "number.parquet": (lambda path: with_metadata(path, "9" * 5000), "digits"),
    "bytes.parquet": (lambda path: with_metadata(path, b"\xff"), "is no JSON"),
    "list.parquet": (lambda path: with_metadata(path, '{"machine": ["a"]}'), "machine is [a]; the name of one"),
    "version.parquet": (lambda path: with_metadata(path, '{"schema_version": {"a": []}}'), "schema_version is {a: []}"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_what_cannot_be_data_is_one_line_at_once(name):
    make, told = HOSTILE[name]
    make(name)
    with at_most(MEMORY), pytest.raises(DataError) as caught:
        read_measured(name, "gpm2002")
    line = str(caught.value)
    assert line.startswith(f"{name}: ")
    assert told in line
    assert "\n" not in line
    assert len(line) < 500


def test_a_small_file_that_unpacks_to_a_large_one_is_told(monkeypatch):
    monkeypatch.setattr(data_file, "LARGEST_UNPACKED", 10_000_000)
    table("unpacks.parquet", {"enc_1": ["x" * 20_000_000]}, compression="zstd", write_statistics=False)
    assert os.path.getsize("unpacks.parquet") < 10_000
    with pytest.raises(DataError, match=r"unpacks\.parquet: unpacks to 20 MB"):
        read_measured("unpacks.parquet", "gpm2002")


def test_a_pipe_beside_a_table_is_told_too():
    written("run.csv", "enc_1\n1\n")
    os.mkfifo("run.json")
    with pytest.raises(DataError, match=r"run\.json beside it"):
        read_measured("run.csv", "gpm2002")


@pytest.mark.parametrize("name", ["pipe.csv", "zero.csv", "folder.csv", "ten_gigabytes.csv", "million.csv", "nul.csv"])
@pytest.mark.parametrize("problem", ["full11", "orthoglide6"])
def test_readings_of_a_problem_pass_the_same_door(problem, name):
    make, told = HOSTILE[name]
    make(name)
    with pytest.raises(ValueError, match="readings=") as caught:
        getattr(problems, problem).from_readings(name)
    assert told in str(caught.value)
    code, line = said("run", f"problem={problem}", f"problem.readings={name}", "optimizer=lm", "--dry-run")
    assert code == 2
    assert told in line
    assert line.count("\n") == 1


STUDY = "problem: full11\nsweeps:\n  - [optimizer=de]\n"
ALIASES = "a0: &a0 [x, x, x]\n" + "".join(f"a{k}: &a{k} [{', '.join(9 * [f'*a{k - 1}'])}]\n" for k in range(1, 10))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (STUDY + ALIASES, "more than 100000 characters with its aliases written out"),
        (STUDY + ALIASES.replace("[", "{k: [").replace("]", "]}"), "with its aliases written out"),
        (STUDY + "a: &a [*a]\n", "the alias *a stands inside of what it names"),
        (STUDY + "a: &a 1\nb: &a {c: *a}\n", "the alias *a stands inside of what it names"),
        (STUDY + "a: " + "[" * 1000 + "]" * 1000, "more than 30 deep in each other"),
        (STUDY + "a: " + "{a: " * 1000 + "}" * 1000, "more than 30 deep in each other"),
        (STUDY + f"a: {'x' * 20_000}\n", "a word has 20000 characters"),
        (STUDY + "# \n" * 100_000, "and at most 0.1 MB are read"),
        (STUDY + "\0", "holds NUL bytes"),
    ],
)
def test_a_study_that_no_parser_could_finish_is_one_line(text, told):
    written("mine.yaml", text)
    with at_most(MEMORY):
        code, line = said("run", "study=mine.yaml")
    assert (code, line.count("\n")) == (2, 1)
    assert line.startswith("bench: study=mine.yaml: cannot be read: ")
    assert told in line


def test_a_study_with_an_alias_is_read():
    written("mine.yaml", "budget: &few 20\nseeds: 1\nproblem: full11\nsweeps:\n  - [&de optimizer=de]\n  - [*de]\n")
    assert said("run", "study=mine.yaml", "--dry-run")[0] == 0


@pytest.mark.parametrize("kind", ["coco", "ioh"])
def test_a_pipe_in_a_published_folder_is_told(kind):
    os.mkdir("published")
    os.mkfifo({"coco": "published/f1.info", "ioh": "published/f1.json"}[kind])
    code, line = said("import", kind, "published", "--to", "out")
    assert (code, line.count("\n")) == (2, 1)
    assert "is a pipe, and a file is needed" in line


@pytest.mark.parametrize("verb", ["discover", "design"])
def test_one_file_that_cannot_be_read_is_one_line_and_nothing_is_written(folder, verb):
    os.mkfifo("pipe.csv")
    code, line = said(verb, "machine=gpm2002", "data=pipe.csv")
    assert code == 2
    assert line == "bench: pipe.csv: is a pipe, and a file is needed; write what it gives to a file first\n"
    assert os.listdir(folder) == ["pipe.csv"]


@pytest.mark.parametrize("named", ["data=many", "data=many/*.csv,many/*.parquet"])
def test_the_files_beside_a_hostile_one_are_answered(named):
    os.mkdir("many")
    names = ["pipe.csv", "zero.parquet", "ten_gigabytes.csv", "deep.csv", "wide.parquet", "folder.csv", "packed.csv"]
    with contextlib.chdir("many"):
        for name in names:
            HOSTILE[name][0](name)
        write_measured(read_measured(shipped_path("demo_nothing", "gpm2002")), "good.csv")
        write_measured(read_measured(shipped_path("demo_nothing", "gpm2002")), "new\nline \udce9.csv")
    code, told = said("discover", "machine=gpm2002", named, "pages=none", "--json")
    assert code == 1
    lines = told.splitlines()
    assert len(lines) == len(names) + 3  # a line a file, and one that counts
    assert sum('"verdict": "none"' in line for line in lines) == 2
    for name in names:
        mine = [line for line in lines if f"{name}: " in line]
        assert len(mine) == 1
        assert HOSTILE[name][1] in mine[0]
    assert f"{len(names)} of {len(names) + 2} failed" in lines[-1]


def test_a_file_that_grows_while_it_is_read_is_told(monkeypatch):
    written("run.csv", "enc_1\n1\n")
    look = os.fstat

    def grown(descriptor):
        found = look(descriptor)
        with open("run.csv", "a") as file:
            file.write("2\n")
        return found

    monkeypatch.setattr(data_file.os, "fstat", grown)
    with pytest.raises(ValueError, match="changed while it was read"):
        read_whole("run.csv", LARGEST_TEXT)


def test_a_file_that_is_written_anew_between_two_looks_has_no_verdict(monkeypatch):
    data = read_measured(shipped_path("demo_nothing", "gpm2002"))
    write_measured(data, "run.parquet")

    read = files.read_columns

    def then_changed(path, *stated):
        content = read(path, *stated)
        write_measured(data.rows(np.arange(len(data)) < 100), path)
        return content

    monkeypatch.setattr(files, "read_columns", then_changed)
    code, line = said("discover", "machine=gpm2002", "data=run.parquet")
    assert code == 2
    assert "run.parquet: changed while it was read" in line


def test_a_file_that_goes_between_two_looks_is_told(monkeypatch):
    write_measured(read_measured(shipped_path("demo_nothing", "gpm2002")), "run.parquet")
    read = files.read_columns

    def gone(path, *stated):
        os.unlink(path)
        return read(path, *stated)

    monkeypatch.setattr(files, "read_columns", gone)
    assert said("discover", "machine=gpm2002", "data=run.parquet") == (2, "bench: run.parquet: there is no such file\n")


def test_what_is_as_large_as_may_be_is_read():
    written("wide.csv", ",".join(f"c{i}" for i in range(MOST_COLUMNS)) + "\n" + "1," * (MOST_COLUMNS - 1) + "1\n")
    assert len(read_table("wide.csv").names) == MOST_COLUMNS
    table("wide.parquet", {f"c{i}": [1.0] for i in range(MOST_COLUMNS)})
    assert len(read_measured("wide.parquet", "gpm2002").columns) == MOST_COLUMNS
    sparse("large", 1000)
    assert len(read_whole("large", 1000)) == 1000
    with pytest.raises(ValueError, match="at most"):
        read_whole("large", 999)
    assert LARGEST_TEXT < LARGEST_PARQUET
