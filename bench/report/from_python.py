"""What is asked of finished runs from Python: where they are kept, and the answer that they give.

A source is a store, the path of its folder, a table of its runs, all or some, a `Run` or a list of them.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import pandas as pd
import pyarrow as pa

from calibench.bench.execution.run import Run
from calibench.bench.report.study.answer import Answer, answer_of
from calibench.bench.statistics.names import problem_titles
from calibench.bench.statistics.ranking import LOOK, with_looks
from calibench.bench.statistics.summary import summary
from calibench.bench.statistics.targets import levels_of
from calibench.bench.store.arrays import HITS_SCHEMA, RUNS_SCHEMA, TRACES_SCHEMA, to_pandas
from calibench.bench.store.hits import columns_for, hit_tables
from calibench.bench.store.runs import FOLDER_OF, ResultStore
from calibench.core.options import suggest
from calibench.core.words import counted
from calibench.problems.suites.black_box import COCO_GAPS

Source = ResultStore | str | Path | pd.DataFrame | Run | Sequence[Run]


def answer(source: Source, *, traces: pd.DataFrame | None = None) -> Answer:
    """Return which method is best and how sure that is, as the page of a study and ``bench run`` say it.

    `verdict` is "decided", "undecided", or "alone" where there is one method; `best`, `sure` and `compared` are
    sentences. Of a store, also what is planned and not done is known: then nothing is decided yet. `traces` are
    needed beside a table of runs that does not know its folder.
    """
    chosen = read_source(source, traces=traces)
    store = chosen.of if isinstance(chosen.of, ResultStore) and not isinstance(source, pd.DataFrame) else None
    manifest = store.manifest() if store is not None and store.is_begun else None
    every = chosen.traces()
    return answer_of(chosen.runs, every[every["run_id"].isin(chosen.runs["run_id"])], manifest)


@final
@dataclass(frozen=True)
class Runs:
    """The runs to draw, those of all problems that they were chosen from, and where traces are: a store, or a table."""

    runs: pd.DataFrame
    every: pd.DataFrame
    of: ResultStore | pd.DataFrame | None

    def with_looks(self) -> pd.DataFrame:
        """Return the runs with the number of each method's colour, which is one in all drawings of one source."""
        every = with_looks(self.every, summary(self.every))
        return self.runs.assign(**{LOOK: every.loc[self.runs.index, LOOK]})

    def traces(self) -> pd.DataFrame:
        if self.of is None:
            raise ValueError(
                "traces: this table of runs does not know its folder; give traces=store.traces(), or the store itself"
            )
        return self.of if isinstance(self.of, pd.DataFrame) else self.of.traces()

    def hits(self) -> pd.DataFrame:
        """Return when each run reached each target above the best value known."""
        traces = self.traces()
        levels = levels_of(self.runs, {"gap": COCO_GAPS})
        if levels.empty:
            raise ValueError("no run found a value inside the box: there is no best value to set targets above")
        place = {run_id: i for i, run_id in enumerate(self.runs["run_id"])}
        mine = traces[traces["run_id"].isin(place)]
        mine = mine.iloc[mine["run_id"].map(place).argsort(kind="stable")]
        schema = pa.schema([RUNS_SCHEMA.field(name) for name in columns_for(["gap"])])
        rows, points = (
            # the metadata of pandas name types which it cannot read back
            pa.Table.from_pandas(table[s.names], s, preserve_index=False).replace_schema_metadata(None)
            for table, s in ((self.runs, schema), (mine, TRACES_SCHEMA))
        )
        return to_pandas(pa.concat_tables([HITS_SCHEMA.empty_table(), *hit_tables(rows, [points], levels)]))

    def title(self) -> str:
        titles = problem_titles(self.runs).unique()
        return str(titles[0]) if len(titles) == 1 else counted(len(titles), "problem")


def read_source(source: Source, problem: str | None = None, traces: pd.DataFrame | None = None) -> Runs:
    """Return the runs of `source`, or those on `problem`. Raises `ValueError` where there are none."""
    if isinstance(source, str | Path):
        source = ResultStore(source)
    runs: pd.DataFrame
    of: ResultStore | pd.DataFrame | None
    if isinstance(source, ResultStore):
        runs, of = source.runs(), source
    elif isinstance(source, pd.DataFrame):
        missing = [name for name in RUNS_SCHEMA.names if name not in source]
        if missing:
            raise ValueError(f"this is no table of runs: it has no column {missing[0]!r}; store.runs() returns one")
        runs, of = source, ResultStore(source.attrs[FOLDER_OF]) if FOLDER_OF in source.attrs else None
    else:
        several = [source] if isinstance(source, Run) else list(source)
        wrong = next((one for one in several if not isinstance(one, Run)), None)
        if wrong is not None:
            raise TypeError(f"a store, its path, a table of runs or runs are needed, not {type(wrong).__name__}")
        runs = to_pandas(pa.Table.from_pylist([one.row | {"study": ""} for one in several], RUNS_SCHEMA))
        of = pd.concat([one.trace.assign(run_id=one.run_id) for one in several]) if several else None
    if runs.empty:
        raise ValueError(
            f"{source.folder if isinstance(source, ResultStore) else 'the table'}: there is no run to draw"
        )
    copies = runs[runs["run_id"].duplicated(keep=False)]
    if copies["study"].ne("").any():
        those, them = counted(copies["run_id"].nunique(), "run"), ", ".join(sorted(set(copies["study"])))
        cure = f'runs[runs["study"] == "{copies["study"].iloc[-1]}"]'
        text = f"{those} stand in several studies (of {them}), each counted as a run of its own; {cure} is one study"
        warnings.warn(text, UserWarning, stacklevel=3)
    every = runs = runs.reset_index(drop=True)
    if problem is not None:
        titles = problem_titles(runs)
        names = runs["problem"]  # of a class of the user's own also without its file
        ways = (titles == problem, names == problem, names.str.rpartition(":")[2] == problem)
        mine = next((way for way in ways if way.any()), None)  # what the page calls it comes before shorter names
        if mine is None:
            near = suggest(problem, dict.fromkeys(titles))
            raise ValueError(f"problem={problem!r}: there is none; problem= takes one of them; {near}")
        runs = runs[mine]
    return Runs(runs, every, of if traces is None else traces)
