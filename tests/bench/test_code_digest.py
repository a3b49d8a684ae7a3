"""Which code made a row: what counts, and what does not."""

import re
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.provenance.code_digest import changed_parts, code_digest
from calibench.core import sources


def test_a_digest_has_a_part_for_each_of_problem_optimiser_and_gate():
    digests = {
        (p, o): code_digest(problems.make(p), optimizers.make(o))
        for p in ("full11", "orthoglide6")
        for o in ("de", "ga", "nlopt_LN_BOBYQA")
    }
    assert all(len(part) == 12 for text in digests.values() for part in text.split("."))
    assert changed_parts(digests["full11", "de"], digests["orthoglide6", "de"]) == ["problem"]
    assert changed_parts(digests["full11", "de"], digests["full11", "ga"]) == ["optimizer"]


def test_the_disk_is_asked_once_for_the_file_of_a_module(monkeypatch):
    asked, real = Counter(), sources.isfile

    def isfile(file):
        asked.update([file])
        return real(file)

    monkeypatch.setattr(sources, "isfile", isfile)
    monkeypatch.setattr(sources, "_DIGESTS", {})
    sources._resolved.cache_clear()
    code_digest(problems.make("sensor_zero"), optimizers.make("de"))
    assert max(asked.values()) == 1


def test_the_version_of_the_library_is_of_the_optimisers_part(monkeypatch):
    p, method = problems.make("sensor_zero"), optimizers.make("nlopt_LN_BOBYQA")
    before = code_digest(p, method)
    monkeypatch.setattr("calibench.bench.provenance.code_digest.library_version", lambda package: "99.0")
    assert changed_parts(before, code_digest(p, method)) == ["optimizer"]


def test_every_file_of_the_gate_is_of_the_gates_part(monkeypatch):
    p, method = problems.make("sensor_zero"), optimizers.make("de")
    before, gate, digest = code_digest(p, method), ("evaluator", "calls", "face"), sources.module_digest
    for name in gate:
        edited = f"calibench.bench.gate.{name}"
        with monkeypatch.context() as patch:
            patch.setattr(sources, "module_digest", lambda module, at=edited: "" if module == at else digest(module))
            assert changed_parts(before, code_digest(p, method)) == ["gate"]
    asked = "\n".join(Path(sys.modules[f"calibench.bench.gate.{name}"].__file__).read_text() for name in gate)
    used = set(re.findall(r"calibench\.bench\.([\w.]+)", asked))
    assert used - {f"gate.{name}" for name in gate} == {
        "gate._scan_kernels",  # kernels count wherever they are imported
        "gate.endings",  # no value passes through it
    }


def test_verbs_and_reports_are_no_part_of_the_code_that_ran():
    ran = {
        path
        for thing in (problems.make("full12"), optimizers.make("de"), optimizers.make("pygmo_de"))
        for path in sources.closure(sources.file_of(type(thing).__module__))
    } | sources.closure(sources.file_of("calibench.bench.gate.evaluator"))
    names = {path.stem for path in ran}
    assert {"closed_loop", "_closed_loop_kernels", "differential", "evaluator", "_scan_kernels", "base"} <= names
    assert not names & {"report", "figures", "tables", "cli", "store", "run", "swarm", "orthoglide"}


@pytest.mark.parametrize(
    ("edit", "counts"),
    [
        (lambda text: text + "\nX = 1\n", True),
        (lambda text: text + "\n# a remark\n", False),
        (lambda text: '"""What it is."""\n' + text, False),
    ],
)
def test_only_what_python_runs_counts(tmp_path, monkeypatch, edit, counts):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sources, "_SEEN", {})
    (tmp_path / "counted_mine.py").write_text("from counted_near import f\n")
    (tmp_path / "counted_near.py").write_text("def f(x):\n    return x\n")
    file = tmp_path / "counted_mine.py"
    assert {path.stem for path in sources.closure(file)} == {"counted_mine", "counted_near"}
    near = tmp_path / "counted_near.py"
    near.write_text(edit(near.read_text()) + "\n")
    assert sources.changed({file, near}) is counts


def test_a_class_without_a_source_is_told_by_its_bytecode(monkeypatch):
    def in_a_notebook(value, factor):
        space = {"__name__": "a_notebook", "np": np}
        exec(
            f"def helper(x):\n    return {factor} * float(x @ x)\n"
            "class Bowl:\n    lower, upper, start = -np.ones(2), np.ones(2), np.zeros(2)\n"
            f"    level = {value}\n    def __call__(self, x):\n        return helper(x) + self.level\n",
            space,
        )
        return bench.execute(space["Bowl"](), optimizers.make("de"), budget=3).row["code_digest"]

    assert in_a_notebook(1, 1) == in_a_notebook(1, 1)
    assert len({in_a_notebook(1, 1), in_a_notebook(2, 1), in_a_notebook(1, 2)}) == 3


def test_the_code_is_no_part_of_id_or_seed(monkeypatch):
    def run():
        return bench.execute(problems.make("sensor_zero"), optimizers.make("de"), budget=5).row

    before = run()
    monkeypatch.setattr("calibench.bench.execution.request.digest_of_problem", lambda _: "other")
    after = run()
    assert after["code_digest"].startswith("other.")
    assert not before["code_digest"].startswith("other.")
    assert (after["run_id"], after["seed"], after["best_value"]) == (
        before["run_id"], before["seed"], before["best_value"],
    )  # fmt: skip
