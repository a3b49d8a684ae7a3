"""Tables that no store wrote are refused by every verb; and all that a store writes is not."""

import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.exchange.studies import read_study
from calibench.bench.execution.request import pair_of, read_asked
from calibench.bench.execution.run import Spec
from calibench.bench.execution.standing import lost_run
from calibench.bench.store import tables, tables as seal
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore, merge

pytestmark = pytest.mark.usefixtures("one_process", "undrawn")


class Noisy:
    """A bowl with noise, of two targets and a figure of merit of its own."""

    lower, upper, start, stochastic, minimum, unit = -np.ones(2), np.ones(2), np.full(2, 0.5), True, 0.0, "mm"
    targets, parameters = (1.0, 0.1), ("gain", "offset")
    value = staticmethod(lambda x: float(np.sum(np.square(x))))

    def __call__(self, x):
        return self.value(x) + 0.01 * np.sin(1e6 * x[0])

    def noise_free(self, x):
        return self.value(x)

    def merit(self, x):
        return {"smooth": True}


class Breaks(Noisy):
    """It fails from the start, or at some point."""

    stochastic, noise_free = False, None

    def __init__(self, good: int = 0):
        self.good = self.left = good

    def __call__(self, x):
        self.left -= 1
        if self.left < 0:
            raise ArithmeticError("broken")
        return self.value(x)


class Nothing(Noisy):
    """No value is finite."""

    stochastic, noise_free = False, None

    def __call__(self, x):
        return float("nan")


def write(folder, runs):
    store = ResultStore(folder)
    store.open()
    for run in runs:
        store.write(run)
    store.collect()
    return store


@pytest.fixture(scope="module")
def every_kind(tmp_path_factory):
    """Return a study of runs that ended in every way."""
    own = [Noisy(), Breaks(), Breaks(7), Nothing()]
    runs = [bench.execute(one, optimizers.make("de", population=5), budget=40, seed=1) for one in own]
    runs += [
        bench.execute(problems.make(name), optimizers.make(method), budget=90, seed=seed, start=start)
        for name in ("full11", "sensor_zero")
        for method, start in (("lm", "nominal"), ("de", "random"), ("nlopt_LN_COBYLA", "random"))
        for seed in (0, 1)
    ]
    runs.append(bench.execute(problems.make("sensor_zero"), optimizers.make("pso"), budget=500, seed=0, target=1e12))
    runs.append(bench.execute(Noisy(), optimizers.make("pso"), budget=9, seed=0, start=np.full(2, 0.25)))
    spec = Spec("sensor_zero", {}, "de", {}, 50, 3)
    asked = read_asked(pair_of(problems.make("sensor_zero"), optimizers.make("de")), 50, 3)
    runs.append(lost_run(spec, asked.run_id, "ProcessDied", "it ended"))
    runs.append(lost_run(spec, "0123456789abcdee", "TimeoutError", "too long", timed_out=True, patience=0.0))
    return write(tmp_path_factory.mktemp("kinds") / "study", runs)


def test_what_a_store_writes_is_read_wherever_it_was_copied_and_merged(every_kind, tmp_path):
    rows, _ = every_kind.tables()
    assert set(rows["status"].to_pylist()) == {"ok", "failed", "timeout"}
    assert set(rows["stop_reason"].to_pylist()) >= {"budget", "target", "failed", "timeout"}
    merge([every_kind.folder], tmp_path / "merged")
    ResultStore(tmp_path / "filled").fill(every_kind.runs(), every_kind.traces())
    for name in ("merged", "filled"):
        tables._CHECKED.clear()
        assert len(ResultStore(tmp_path / name).runs()) == len(rows)


def test_published_data_that_were_imported_are_whole(every_kind, run_bench, tmp_path):
    shutil.copytree(every_kind.folder, "study")
    assert run_bench("export ioh study --to ioh")[0] == 0
    assert run_bench("import ioh ioh --to theirs")[0] == 0
    assert run_bench("merge theirs study --to both")[0] == 0
    for name in ("theirs", "both"):
        tables._CHECKED.clear()
        assert len(read_study(name).runs)


def cell(column, value):
    """Return a change of the first row."""

    def change(rows, points):
        return set_column(rows, column, [value, *rows[column].to_pylist()[1:]]), points

    return change


def set_column(table, column, values):
    at = table.schema.get_field_index(column)
    return table.set_column(at, table.schema.field(at), pa.array(values, table.schema.field(at).type))


def longest(points):
    ids = np.array(points["run_id"].to_pylist())
    names, counts = np.unique(ids, return_counts=True)
    return ids == names[np.argmax(counts)]


def kept_points(where):
    def change(rows, points):
        mine = np.flatnonzero(longest(points))
        others = np.flatnonzero(~longest(points))
        return rows, points.take(np.sort(np.concatenate([others, mine[where]])))

    return change


def no_trace(rows, points):
    return rows, points.filter(pa.array(~longest(points)))


def exchanged(column):
    """Return a change by which two runs have each other's values, which each of them could have."""

    def change(rows, points):
        values = rows[column].to_pylist()
        unlike = next(i for i, value in enumerate(values) if value != values[0])
        values[0], values[unlike] = values[unlike], values[0]
        return set_column(rows, column, values), points

    return change


DAMAGES = {
    "evaluations=3000": cell("evaluations", 3000),
    "problem_options='[1]'": cell("problem_options", "[1]"),
    "a trace halved": kept_points(slice(0, 3)),
    "no trace": no_trace,
    "times of another": exchanged("wall_s"),
    "the same values, written anew": lambda rows, points: (rows, points),
}


def spoil(folder, change):
    """Change the tables in `folder` as somebody does who reads and writes them with PyArrow."""
    paths = [folder / name for name in ("runs.parquet", "traces.parquet")]
    before = [pq.read_table(path) for path in paths]
    for path, table, old in zip(paths, change(*before), before, strict=True):
        if table is not old or change is DAMAGES["the same values, written anew"]:
            pq.write_table(table.replace_schema_metadata(old.schema.metadata), path)


@pytest.mark.parametrize("damage", list(DAMAGES))
def test_what_somebody_has_edited_is_refused_in_one_line(every_kind, tmp_path, damage):
    shutil.copytree(every_kind.folder, tmp_path / "study")
    spoil(tmp_path / "study", DAMAGES[damage])
    store = ResultStore(tmp_path / "study")
    for read in (store.runs, store.traces, store.finished, store.survey, store.collect):
        with pytest.raises(StoreError) as refused:
            read()
        said = str(refused.value)
        assert "\n" not in said
        assert ("runs.parquet: was" in said) or ("traces.parquet: was" in said)
        assert "changed after bench wrote it" in said
        assert "left alone" in said


@pytest.mark.parametrize(
    "words",
    [
        "status study", "collect study", "report study", "show {0} study", "compare study study", "choose study",
        "export csv study --to out", "export ioh study --to out", "merge study --to out",
        "run problem=sensor_zero optimizer=de budget=50 seeds=1 study=study results=.",
    ],
)  # fmt: skip
@pytest.mark.parametrize("damage", ["evaluations=3000", "problem_options='[1]'", "a trace halved", "times of another"])
def test_every_verb_refuses_a_damaged_table_in_one_line(every_kind, run_bench, tmp_path, words, damage):
    shutil.copytree(every_kind.folder, "study")
    run_id = every_kind.runs()["run_id"].iloc[0]
    spoil(tmp_path / "study", DAMAGES[damage])
    before = {path: path.read_bytes() for path in (tmp_path / "study").glob("*.parquet")}
    code, _, err = run_bench(words.format(run_id))
    assert code == 2
    assert err.count("\n") == 1
    assert err.startswith("bench: ")
    assert "s.parquet: " in err
    assert {path: path.read_bytes() for path in before} == before
    assert not (tmp_path / "out").exists()


def test_one_bit_of_a_table_is_noticed(every_kind, tmp_path):
    shutil.copytree(every_kind.folder, tmp_path / "study")
    path = tmp_path / "study/traces.parquet"
    raw = bytearray(path.read_bytes())
    for at in range(4, len(raw) - 8 - int.from_bytes(raw[-8:-4], "little"), 997):
        changed = raw.copy()
        changed[at] ^= 4
        path.write_bytes(changed)
        tables._CHECKED.clear()
        with pytest.raises(StoreError, match=r"traces\.parquet"):
            ResultStore(tmp_path / "study").runs()


@pytest.mark.parametrize("said", ["", "[", "[1]", "null"])
def test_statements_that_were_damaged_are_an_edit(every_kind, tmp_path, said):
    shutil.copytree(every_kind.folder, tmp_path / "study")
    path = tmp_path / "study/traces.parquet"
    pq.write_table(pq.read_table(path).replace_schema_metadata({"calibench": said}), path)
    with pytest.raises(StoreError, match=r"traces\.parquet"):
        ResultStore(tmp_path / "study").runs()


def test_a_table_is_sealed_as_it_gets_its_name_and_other_readers_do_not_see_it(every_kind):
    for name in ("runs.parquet", "traces.parquet"):
        path = every_kind.folder / name
        assert seal.is_whole(path)
        assert list(pq.read_schema(path).metadata) == [b"calibench"]
