"""What the documents print runs: their Python as it stands, their commands as far as a dry run goes."""

import doctest
import re
import shlex
import sys
from pathlib import Path

import pytest

from calibench.bench.cli import main
from tests.tutorial_session import PAGES

ROOT = Path(__file__).resolve().parent.parent
SESSIONS = [ROOT / "docs" / page for page in PAGES]  # run as a whole by test_tutorials.py
DOCUMENTS = [ROOT / "README.md", *(page for page in sorted((ROOT / "docs").glob("*.md")) if page not in SESSIONS)]


def blocks(language):
    for document in DOCUMENTS:
        for i, block in enumerate(re.findall(rf"```{language}\n(.*?)```", document.read_text(), re.DOTALL)):
            yield pytest.param(block, id=f"{document.name}-{i}")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    page = (ROOT / "docs" / "own-problem.md").read_text()
    own = "\n".join(b for b in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "class " in b)
    rosenbrock = next(
        b for b in re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL) if "class " in b
    )
    (tmp_path / "mine.py").write_text(own + rosenbrock.partition("for name")[0])
    sys.modules.pop("mine", None)
    return tmp_path


@pytest.mark.parametrize("block", list(blocks("python")))
def test_the_python_of_the_documents_runs(block, here):
    if "results/cong2008" in block:
        with pytest.raises(SystemExit):
            main(["run", "study=cong2008", "budget=30", "seeds=1"])
    if ">>>" in block:
        session = doctest.DocTestParser().get_doctest(block, {}, "document", None, 0)
        assert session.examples
        assert doctest.DocTestRunner().run(session).failed == 0
        return
    exec(compile(block, "document", "exec"), {"__name__": "document"})


@pytest.mark.parametrize("block", list(blocks("sh")))
def test_the_commands_of_the_documents_are_understood(block, here):
    from calibench import problems

    readings = problems.make("full11").readings
    (here / "readings.csv").write_text("\n".join(",".join(map(str, row)) for row in readings.tolist()))
    (here / "mine.yaml").write_text("budget: 60\nseeds: 2\nsweeps:\n  - [problem=sensor_zero, optimizer=de]\n")
    for line in block.splitlines():
        words = shlex.split(line, comments=True)
        if words[:2] == ["bench", "run"]:
            words += ["--dry-run"]
        elif words[0] == "make":
            assert f"\n{words[1]}:" in (ROOT / "Makefile").read_text()
            continue
        elif words[1] in ("report", "status", "merge", "compare", "export"):
            continue
        with pytest.raises(SystemExit) as ended:
            main(words[1:])
        assert ended.value.code == 0, line
