"""What the documents print runs: their Python as it stands, their commands (sweeps as a dry run); or tells why not."""

import contextlib
import doctest
import gc
import glob
import importlib.util
import io
import re
import shlex
import shutil
import sys
from pathlib import Path

import pytest

from calibench.bench.cli import main
from calibench.bench.sweep import costs
from tests.bench.conftest import empty_drawings
from tests.documented import BLOCKS, COMMANDS
from tests.tutorial_session import PAGES

ROOT = Path(__file__).resolve().parent.parent
SESSIONS = [ROOT / "docs" / page for page in PAGES]  # run as a whole by test_tutorials.py
EXTRAS = {"bbob": "cocoex", "ioh": "ioh"}  # suites whose packages are extras
DOCUMENTS = [ROOT / "README.md", *(page for page in sorted((ROOT / "docs").glob("*.md")) if page not in SESSIONS)]


LONG = {
    *(("sh", block) for block in ("discover.md-0", "guide.md-2", "guide.md-3", "suites.md-0", "exchange.md-1")),
    *(("python", block) for block in ("guide.md-0", "discover.md-2")),
}  # several seconds each


ROUNDED = re.compile(r"(?<=best )\S+|\d+(?= evaluations.*converged)")  # what another processor may round otherwise


def blocks(language):
    for document in DOCUMENTS:
        for i, block in enumerate(re.findall(rf"```{language}\n(.*?)```", document.read_text(), re.DOTALL)):
            name = f"{document.name}-{i}"
            yield pytest.param(block, id=name, marks=[pytest.mark.slow] if (language, name) in LONG else [])


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.setattr(costs, "CAN_FORK", False)  # a child that measures loads each kernel anew
    monkeypatch.setattr(costs, "_MEASURING", 1e-3)  # what a dry run takes is no matter here
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    page = (ROOT / "docs" / "own-problem.md").read_text()
    own = "\n".join(b for b in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "class " in b)
    rosenbrock = next(
        b for b in re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL) if "class " in b
    )
    (tmp_path / "mine.py").write_text(own + rosenbrock)
    demo = ROOT / "discrepancy" / "demo" / "arm"
    shutil.copy(demo / "six.urdf", tmp_path / "arm.urdf")
    (tmp_path / "readings.csv").write_text((demo / "demo_sound.csv").read_text().partition("\n")[2])
    sys.modules.pop("mine", None)
    return tmp_path


@pytest.fixture(scope="module")
def small_study(tmp_path_factory):
    """A study of a few runs, which stands for the studies that commands report, merge, compare and export."""
    folder = tmp_path_factory.mktemp("study")
    with pytest.raises(SystemExit):
        main(shlex.split(f"run -m problem=sensor_zero optimizer=lm,de budget=160 seeds=2 study=small results={folder}"))
    return folder / "small"


@pytest.mark.parametrize("block", list(blocks("python")))
def test_the_python_of_the_documents_runs(block, here, capsys):
    if "results/cong2008" in block:
        with pytest.raises(SystemExit):
            main(["run", "study=cong2008", "budget=30", "seeds=1"])
    if ">>>" in block:
        session = doctest.DocTestParser().get_doctest(block, {}, "document", None, 0)
        assert session.examples
        assert doctest.DocTestRunner().run(session).failed == 0
        return
    exec(compile(block, "document", "exec"), {"__name__": "__main__" if "__main__" in block else "document"})
    told = re.escape(f"```python\n{block}```\n\n```text\n")
    for document in DOCUMENTS:
        for printed in re.findall(rf"{told}(.*?)```", document.read_text(), re.DOTALL):
            assert ROUNDED.sub("", capsys.readouterr().out) == ROUNDED.sub("", printed)


@pytest.fixture(scope="module")
def undrawn():
    gc.collect()  # a program of another page ends when its pipe closes, which children forked here would hold open
    with empty_drawings():
        yield


@pytest.mark.usefixtures("at_one_noise", "without_formula", "undrawn")
@pytest.mark.parametrize("block", list(blocks("sh")))
def test_the_commands_of_the_documents_are_given(block, here, small_study, capsys):
    from calibench import problems

    readings = problems.make("full11").readings
    (here / "readings.csv").write_text("\n".join(",".join(map(str, row)) for row in readings.tolist()))
    (here / "mine.yaml").write_text("budget: 60\nseeds: 2\nsweeps:\n  - [problem=sensor_zero, optimizer=de]\n")
    for name in ("adhoc", "mine", "other", "bipop", "bbob"):
        shutil.copytree(small_study, here / "results" / name)
    for part in ("a", "b", "part1", "part2"):
        shutil.copytree(small_study, here / part / "mine")
    for line in block.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if shlex.join(words) in _NOT_RUN:
            continue
        if words[0] == "make":
            assert f"\n{words[1]}:" in (ROOT / "Makefile").read_text()
            continue
        if words[:2] == ["bench", "run"]:
            words += ["--dry-run"]
        elif words[1] == "merge":
            words[2:] = [found for word in words[2:] for found in (sorted(glob.glob(word)) or [word])]
            shutil.rmtree(here / "results" / "mine", ignore_errors=True)
        with pytest.raises(SystemExit) as ended:
            main(words[1:])
        said = capsys.readouterr().err
        needed = {word.removeprefix("problem=") for word in words} & set(EXTRAS)
        if words[1] == "run" and needed and not all(importlib.util.find_spec(EXTRAS[one]) for one in needed):
            assert ended.value.code == 2, line
            assert "pip install" in said, line  # told, not met by accident
            continue
        assert ended.value.code == 0, line + said


_NOT_RUN = {shlex.join(shlex.split(command)) for command in COMMANDS}


def usage():
    told = io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.suppress(SystemExit):
        main(["--help"])
    return told.getvalue()


def fenced():
    """Yield (page, language, file, text) of every block of the pages, README.md's and those of docs/."""
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for language, file, text in re.findall(
            r"^ *```(\w*)([^\n]*)\n(.*?)^ *```", page.read_text(), re.DOTALL | re.MULTILINE
        ):
            yield page.name, language, file.strip(), text


def test_every_block_is_run_or_stands_in_the_list_with_its_reason():
    told = set()
    for page, language, file, text in fenced():
        listed = {key for key in BLOCKS if key[0] == page and text.lstrip().startswith(key[1])}
        told |= listed
        is_session = page in PAGES and (language in ("python", "console") or file)
        is_run = is_session or language in ("python", "sh")
        assert is_run != bool(listed), f"{page}: run by no test, or run and listed too:\n{text}"
    assert told == set(BLOCKS), "listed, and in no page"


def test_every_command_that_is_not_given_stands_in_a_page():
    lines = {
        shlex.join(shlex.split(line, comments=True))
        for _, language, _, text in fenced()
        if language == "sh"
        for line in text.replace("\\\n", " ").splitlines()
    }
    assert lines >= _NOT_RUN


def test_a_reason_that_names_a_test_names_one_that_is_there():
    for reason in (*BLOCKS.values(), *COMMANDS.values()):
        for path in re.findall(r"\b(?:tests|docs)/[\w/.]*\w", reason):
            assert (ROOT / path).exists(), path


def test_verbs_and_targets_that_are_named_in_the_text_are_there():
    verbs = set(re.findall(r"^  ([a-z|]+) ", usage(), re.MULTILINE))
    verbs = {verb for group in verbs for verb in group.split("|")} | {"VERB"}
    makefile = (ROOT / "Makefile").read_text()
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
        for verb in re.findall(r"`bench ([a-z]+)\b", text):
            assert verb in verbs, f"{page.name}: bench {verb}"
        for target in re.findall(r"`make\s([a-z]+)\b", text):
            assert f"\n{target}:" in makefile, f"{page.name}: make {target}"
