"""The tutorials are sessions that run: each command prints what its page says, each file does what it promises."""

import re
import subprocess
import sys
import tomllib

import pytest

from calibench.discrepancy import machines
from calibench.discrepancy.registries import effects
from tests.tutorial_session import DOCS, PAGES, alike, play

QUICK = ("hand-eye.md",)


@pytest.fixture
def own_folder(tmp_path, monkeypatch):
    machines.names()  # with the effects of each, which would else be gone with those that a page enters
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    for kept in ("_factories", "_options", "_order"):  # effects that a page enters are gone with it
        monkeypatch.setattr(effects, kept, dict(getattr(effects, kept)))
    yield tmp_path
    for name in [name for name, module in sys.modules.items() if str(tmp_path) in str(getattr(module, "__file__", ""))]:
        del sys.modules[name]


@pytest.mark.parametrize("page", [p if p in QUICK else pytest.param(p, marks=pytest.mark.slow) for p in PAGES])
def test_what_a_tutorial_shows_is_what_its_commands_print(page, own_folder):
    count = 0
    for command, shown, got in play((DOCS / page).read_text()):
        assert alike(shown, got), f"{command}\n{got}\n`python -m tests.tutorial_session` writes this into the page"
        count += 1
    assert count >= 3


def test_words_are_compared_to_the_letter_and_numbers_to_five_per_cent():
    assert alike("play 0.242 mrad\n", "play 0.240  mrad\n")
    assert not alike("play 0.242 mrad", "play 0.282 mrad")
    assert not alike("play of joint 2", "lag of joint 2")
    assert not alike("backlash of joint 2, 0.242", "backlash of joint 1, 0.242")
    assert not alike("", "ValueError")


def test_the_guide_quotes_the_tutorial():
    quoted = (DOCS / "guide.md").read_text().partition("## What the model is missing")[2].partition("\n## ")[0]
    [size] = re.findall(r"finds ([\d.]+ mrad) of play in (?:joint 2)", quoted)
    assert f"backlash of joint 2, {size} (95 %" in (DOCS / "tutorial-discovery.md").read_text()


def test_a_machine_and_its_effect_take_forty_lines():
    page = (DOCS / "own-machine.md").read_text()
    [code] = re.findall(r"```python arm.py\n(.*?)```", page, re.DOTALL)
    assert sum(bool(line.strip()) for line in code.splitlines()) <= 40  # empty lines are the formatter's


def test_the_entry_points_of_the_page_announce_the_machine_and_its_effect(tmp_path):
    page = (DOCS / "own-machine.md").read_text()
    [code] = re.findall(r"```python arm.py\n(.*?)```", page, re.DOTALL)
    [announced] = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "arm.py").write_text(code)
    info = tmp_path / "arm-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: arm\nVersion: 1.0\n")
    lines = []
    for group, points in tomllib.loads(announced)["project"]["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines))
    ask = (
        "from calibench.discrepancy import machines;"
        "from calibench.discrepancy.registries import own_families, effects as registry;"
        "print([f.name for f in own_families('two_link')], machines.make('two_link').name, registry.left_out)"
    )
    done = subprocess.run([sys.executable, "-c", ask], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "['sag'] two_link {}\n", done.stderr
