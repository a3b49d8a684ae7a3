"""Tables that no store wrote are refused, by row and column, by every verb; and all that a store writes is not."""

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
from calibench.bench.store.damage import first_damage
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


def test_what_a_store_writes_has_no_damage(every_kind, tmp_path):
    rows, points = every_kind.tables()
    assert set(rows["status"].to_pylist()) == {"ok", "failed", "timeout"}
    assert set(rows["stop_reason"].to_pylist()) >= {"budget", "target", "failed", "timeout"}
    assert first_damage(rows, points) is None
    merge([every_kind.folder], tmp_path / "merged")
    ResultStore(tmp_path / "filled").fill(every_kind.runs(), every_kind.traces())
    for name in ("merged", "filled"):
        tables._CHECKED.clear()
        assert first_damage(*ResultStore(tmp_path / name).tables()) is None


def test_published_data_that_were_imported_have_no_damage(every_kind, run_bench, tmp_path):
    shutil.copytree(every_kind.folder, "study")
    assert run_bench("export ioh study --to ioh")[0] == 0
    assert run_bench("import ioh ioh --to theirs")[0] == 0
    assert run_bench("merge theirs study --to both")[0] == 0
    for name in ("theirs", "both"):
        tables._CHECKED.clear()
        assert first_damage(*ResultStore(name).tables()) is None
        assert len(read_study(name).runs)


def cell(column, value, row=0):
    """Return a change of one cell of `runs.parquet`."""

    def change(rows, points):
        values = rows[column].to_pylist()
        at = next(i for i in range(len(values)) if rows["run_id"][i].as_py() == WHOSE[row](rows))
        values[at] = value(values[at]) if callable(value) else value
        return set_column(rows, column, values), points

    return change


def point(column, change_values):
    """Return a change of one column of the longest trace."""

    def change(rows, points):
        mine = longest(points)
        values = np.array(points[column].to_pylist())
        values[mine] = change_values(values[mine])
        return rows, set_column(points, column, values.tolist())

    return change


def set_column(table, column, values):
    at = table.schema.get_field_index(column)
    return table.set_column(at, table.schema.field(at), pa.array(values, table.schema.field(at).type))


def longest(points):
    ids = np.array(points["run_id"].to_pylist())
    names, counts = np.unique(ids, return_counts=True)
    return ids == names[np.argmax(counts)]


def first_of(**wanted):
    def find(rows):
        keep = np.all(
            [np.array(rows[name].to_pylist(), dtype=object) == value for name, value in wanted.items()], axis=0
        )
        return rows["run_id"][int(np.argmax(keep))].as_py()

    return find


WHOSE = {
    0: first_of(optimizer="de", problem="full11"),
    "lm": first_of(optimizer="lm", problem="full11"),
    "failed": first_of(status="failed", problem=f"{__name__}:Breaks"),
    "noisy": first_of(status="ok", problem=f"{__name__}:Noisy"),
}


def kept_points(where):
    def change(rows, points):
        mine = np.flatnonzero(longest(points))
        others = np.flatnonzero(~longest(points))
        return rows, points.take(np.sort(np.concatenate([others, mine[where]])))

    return change


def reversed_points(rows, points):
    order = np.arange(len(points))
    mine = np.flatnonzero(longest(points))
    order[mine] = mine[::-1]
    return rows, points.take(order)


def second_trace(rows, points):
    mine = points.filter(pa.array(longest(points)))
    return rows, pa.concat_tables([points, points.slice(0, 1), mine]) if longest(points)[-1] else pa.concat_tables(
        [points, mine]
    )


def no_trace(rows, points):
    return rows, points.filter(pa.array(~longest(points)))


def other_run(rows, points):
    ids = points["run_id"].to_pylist()
    return rows, set_column(points, "run_id", ["f" * 16, *ids[1:]])


def exchanged(column):
    """Return a change by which two runs have each other's values, which each of them could have."""

    def change(rows, points):
        values = rows[column].to_pylist()
        unlike = next(i for i, value in enumerate(values) if value != values[0])
        values[0], values[unlike] = values[unlike], values[0]
        return set_column(rows, column, values), points

    return change


ROWS = {
    "evaluations": [3000, -1, 0, None],
    "jacobian_evaluations": [7, -1],
    "charged": [3000, -5, 1, None],
    "non_finite": [10**6, -1],
    "batch_evaluations": [10**6, -1],
    "residual_evaluations": [10**6, -1],
    "outside_evaluations": [-1],
    "restarts": [-1],
    "judged_evaluations": [-1],
    "dimension": [-11, 3],
    "repetition": [-1, 77, None],
    "budget": [1, 0, -300, 91],
    "target": [0.5],
    "status": ["", "OK", "timeout", "failed", None],
    "stop_reason": ["", "because", "failed", "timeout"],
    "error_type": ["ValueError"],
    "start": ["anywhere", "nominal"],
    "best_value": [-1e9, float("nan"), float("inf"), float("-inf"), 0.0, None],
    "best_evaluation": [0, -1, 10**6, None],
    "best_x": [[1.0], [float("nan")] * 11],
    "parameter_values": [[1.0]],
    "parameter_truths": [[1.0]],
    "targets": [[1.0, 2.0], [1.0, 1.0]],
    "hits": [[1] * 60, [10**6]],
    "hits_charged": [[-1], []],
    "problem": ["full12", "os:system", "", None],
    "optimizer": ["lm", "mine:Mine"],
    "problem_options": ["[1]", "", "{", "null", '"a"', "{}", None, "[" * 20000],
    "optimizer_options": ["[1]", "7", '{"population":7}'],
    "versions": ["[1]", "none"],
    "merit": ["[1]"],
    "data_id": ["other"],
    "seed": ["0" * 16],
    "run_id": ["0" * 16, "", "a b", "../../etc"],
    "wall_s": [-1.0],
    "cpu_s": [-1.0],
}  # fmt: skip  # column -> values that the run cannot have
DAMAGES = {
    **{f"{column}={value!r:.30}": (cell(column, value), column) for column, many in ROWS.items() for value in many},
    "a failed run without a type": (cell("error_type", None, "failed"), "error_type"),
    "a failed run that is ok": (cell("status", "ok", "failed"), "stop_reason"),
    "a judged answer": (cell("judged_evaluations", -3, "noisy"), "judged_evaluations"),
    "Jacobians left out": (cell("jacobian_evaluations", 0, "lm"), "charged"),
    "a trace halved": (kept_points(slice(0, 3)), "evaluations"),
    "a trace without its end": (kept_points(slice(0, -1)), "evaluations"),
    "a trace reversed": (reversed_points, ""),
    "a second trace": (second_trace, "run_id"),
    "no trace": (no_trace, "evaluations"),
    "a trace of no run": (other_run, "run_id"),
    "values that rise": (point("best_value", lambda values: values[::-1]), "best_value"),
    "values that are lower": (point("best_value", lambda values: values - 1e9), "best_value"),
    "a value that is none": (point("best_value", lambda values: values * np.nan), "best_value"),
    "counts that fall": (point("evaluations", lambda values: values[::-1]), ""),
    "counts from 0 on": (point("evaluations", lambda values: values - values[0] - 1), ""),
    "charges that fall": (point("charged", lambda values: values[::-1]), "charged"),
    "restarts below 0": (point("restart", lambda values: values - 5), "restart"),
    "times of another": (exchanged("wall_s"), None),
    "errors of another": (exchanged("parameter_error_mm"), None),
    "the same values, written anew": (lambda rows, points: (rows, points), None),
}
FEW = ("evaluations=3000", "problem_options='[1]'", "a trace halved", "times of another")


def spoil(folder, change):
    """Change the tables in `folder` as somebody does who reads and writes them with PyArrow."""
    paths = [folder / name for name in ("runs.parquet", "traces.parquet")]
    before = [pq.read_table(path) for path in paths]
    for path, table, old in zip(paths, change(*before), before, strict=True):
        if table is not old or change is DAMAGES["the same values, written anew"][0]:
            pq.write_table(table.replace_schema_metadata(old.schema.metadata), path)


@pytest.mark.parametrize("damage", list(DAMAGES))
def test_what_no_run_can_have_is_refused_with_its_file_and_row_and_column(every_kind, tmp_path, damage):
    change, column = DAMAGES[damage]
    shutil.copytree(every_kind.folder, tmp_path / "study")
    spoil(tmp_path / "study", change)
    with pytest.raises(StoreError) as refused:
        ResultStore(tmp_path / "study").runs()
    said = str(refused.value)
    assert "\n" not in said
    assert len(said) < 1000
    assert ("runs.parquet: " in said) or ("traces.parquet: " in said)
    assert "left alone" in said
    assert "was changed after bench wrote it" in said if column is None else "row" in said, said
    assert not column or column in said or "run_id" in said, said


@pytest.mark.parametrize("read", ["traces", "finished", "survey", "collect"])
@pytest.mark.parametrize("damage", FEW)
def test_whatever_reads_a_damaged_table_refuses_it(every_kind, tmp_path, read, damage):
    shutil.copytree(every_kind.folder, tmp_path / "study")
    spoil(tmp_path / "study", DAMAGES[damage][0])
    with pytest.raises(StoreError, match="left alone"):
        getattr(ResultStore(tmp_path / "study"), read)()


def test_most_damages_are_named_by_row_and_column():
    assert len(DAMAGES) > 43
    assert sum(column is None for _, column in DAMAGES.values()) == 3


@pytest.mark.parametrize(
    "words",
    [
        "status study", "collect study", "report study", "show {0} study", "compare study study", "choose study",
        "export csv study --to out", "export ioh study --to out", "merge study --to out",
        "run problem=sensor_zero optimizer=de budget=50 seeds=1 study=study results=.",
    ],
)  # fmt: skip
@pytest.mark.parametrize("damage", ["evaluations=3000", "a trace halved"])
def test_every_verb_refuses_a_damaged_table_in_one_line(every_kind, run_bench, tmp_path, words, damage):
    shutil.copytree(every_kind.folder, "study")
    run_id = every_kind.runs()["run_id"].iloc[0]
    spoil(tmp_path / "study", DAMAGES[damage][0])
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
