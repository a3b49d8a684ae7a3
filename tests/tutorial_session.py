"""A tutorial page as a session: its files are saved, its commands given, its Python run, in order and in one folder.

```python NAME.py     a file, saved as it stands; so is ```yaml NAME.yaml
```python             code, or a doctest where it has prompts
```console            `$ command` lines, each with what it printed; `| grep WORDS` and `| tail -N` are understood

`python -m tests.tutorial_session` runs the pages and writes what the commands print now, and the pictures, into them.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from calibench.bench.cli import main

DOCS = Path(__file__).resolve().parent.parent / "docs"
PAGES = (
    "tutorial-discovery.md",
    "own-machine.md",
    "choosing-options.md",
    "my-mount.md",
    "my-printer.md",
    "my-simulator.md",
    "my-table.md",
    "own-suite.md",
    "comparing.md",
    "my-robot.md",
    "hand-eye.md",
)
PICTURES = {
    "images/discovery_backlash.png": "results/discover/demo_backlash/figures/residuals_1.png",
    "images/my_robot.png": "results/calibrate/my_poses/figures/joints.png",
}  # in docs <- as the first page's commands leave it

_BLOCK = re.compile(r"```(python|yaml|console)([^\n]*)\n(.*?)```", re.DOTALL)
_PROGRESS = re.compile(r"^ +(\d+/\d+ runs, |searching ).*\n", re.MULTILINE)  # of a sweep or a search, on stderr
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e-?\d+)?(?: %)?")


def play(page: str) -> Iterator[tuple[str, str, str]]:
    """Yield (command, what the page says it prints, what it printed) for each command, in the working folder."""
    names: dict[str, object] = {"__name__": "session"}
    for language, file, block in _BLOCK.findall(page):
        if file:
            Path(file.strip()).write_text(block)
        elif language == "console":
            for said in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
                command, _, shown = said.partition("\n")
                yield command, shown, printed(command)
        elif ">>>" in block:
            session = doctest.DocTestParser().get_doctest(block, names, "page", None, 0)
            runner, told = doctest.DocTestRunner(), io.StringIO()
            runner.run(session, out=told.write, clear_globs=False)
            names = session.globs
            yield "Python", "", told.getvalue()
        else:
            exec(compile(block, "page", "exec"), names)


def printed(command: str) -> str:
    """Return what `command` prints: bench's, a Python file's, or a file; raise `RuntimeError` where it fails."""
    command, *pipes = re.split(r" \| (?=grep |tail )", command)
    words = shlex.split(command)
    said, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(errors):
        if words[0] == "bench":
            with contextlib.suppress(SystemExit):
                main(words[1:])
        elif words[0] == "python":
            runpy.run_path(words[1], run_name="__main__")
        elif words[0] == "cat":
            print(Path(words[1]).read_text(), end="")
        else:
            raise RuntimeError(f"{command}: neither bench, python nor cat")
    wrong = _PROGRESS.sub("", errors.getvalue())
    if wrong:
        raise RuntimeError(f"{command}: {wrong}")
    text = said.getvalue()
    for pipe in pipes:
        text = subprocess.run(shlex.split(pipe), input=text, stdout=subprocess.PIPE, text=True, check=True).stdout
    lines = text.rstrip("\n").split("\n")
    return "".join(f"{line.rstrip()}\n" for line in lines if line or len(lines) > 1)


def alike(shown: str, got: str) -> bool:
    """Return whether words and whole numbers agree to the letter, others and per cents to 5 % and a last digit."""
    if _spaced(_NUMBER.sub("#", shown)) != _spaced(_NUMBER.sub("#", got)):
        return False
    return all(_near(*pair) for pair in zip(_NUMBER.findall(shown), _NUMBER.findall(got), strict=True))


def _near(shown: str, got: str) -> bool:
    if shown == got:
        return True
    number, of_got = shown.removesuffix(" %"), got.removesuffix(" %")
    if number == shown and "." not in number:  # of a joint, of readings
        return False
    digit = 10.0 ** -len(number.partition(".")[2].partition("e")[0])
    return abs(float(number) - float(of_got)) <= 0.05 * abs(float(number)) + digit


def _spaced(text: str) -> str:
    return " ".join(text.split())


def rewrite() -> None:
    """Put into each page what its commands print now, and the pictures they leave."""
    for name in PAGES:
        text = (DOCS / name).read_text()
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            sys.path.insert(0, folder)
            for command, shown, got in play(text):
                text = text.replace(f"$ {command}\n{shown}", f"$ {command}\n{got}" + ("\n" if got else ""))
            for picture, left in PICTURES.items():
                if os.path.exists(left):
                    shutil.copy(left, DOCS / picture)
        (DOCS / name).write_text(re.sub(r"\n\n+```\n", "\n```\n", text))


if __name__ == "__main__":
    rewrite()
