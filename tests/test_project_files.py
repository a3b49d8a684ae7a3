"""Workflow, pre-commit hooks and citation say what pyproject.toml, the Makefile and the data of the papers say."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MAKEFILE = (ROOT / "Makefile").read_text()
WORKFLOW = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
JOBS = yaml.safe_load(WORKFLOW)["jobs"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
HOOKS = [
    hook for repo in yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"] for hook in repo["hooks"]
]
PAPERS = ("cong2008", "pashkevich2008")


def pinned(name: str) -> Requirement:
    [found] = [r for r in map(Requirement, PROJECT["dependencies"]) if r.name == name]
    return found


def commands(job: str) -> str:
    return "\n".join(step.get("run", "") for step in JOBS[job]["steps"])


def test_all_pythons_are_tested_whole_on_linux() -> None:
    assert JOBS["linux"]["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13", "3.14"]
    assert all(SpecifierSet(PROJECT["requires-python"]).contains(v) for v in ("3.11", "3.14"))
    assert not SpecifierSet(PROJECT["requires-python"]).contains("3.10")
    assert "make test" in commands("linux")


def test_elsewhere_a_marker_leaves_pygmo_out() -> None:
    assert JOBS["elsewhere"]["strategy"]["matrix"]["os"] == ["macos-latest", "windows-latest"]
    marker = pinned("pygmo").marker
    assert marker is not None
    assert marker.evaluate({"sys_platform": "linux"})
    assert not any(marker.evaluate({"sys_platform": system}) for system in ("darwin", "win32"))


def test_one_row_keeps_the_pin_of_hydra_and_the_next_release_overrides_it() -> None:
    rows = JOBS["hydra"]["strategy"]["matrix"]["include"]
    now, following = (Requirement(row["hydra"]) for row in rows)
    assert now.specifier == pinned("hydra-core").specifier
    assert [row["next"] for row in rows] == [False, True]
    for release in ("1.4.0rc1", "1.4.0rc3", "1.4.2"):
        assert following.specifier.contains(release, prereleases=True)
        assert not pinned("hydra-core").specifier.contains(release, prereleases=False)
    said = commands("hydra")
    assert said.index('pip install -e ".[dev]"') < said.index("pip install --pre --upgrade")


@pytest.mark.parametrize("job", JOBS)
def test_what_a_job_names_is_there(job: str) -> None:
    said = commands(job)
    for target in re.findall(r"\bmake ([a-z]+)", said):
        assert f"\n{target}:" in MAKEFILE, target
    for path in re.findall(r"\btests/[\w/.]+", said):
        assert (ROOT / path).exists(), path
    assert JOBS[job]["steps"][-1].get("run")


def test_the_hooks_are_the_tools_that_make_test_runs() -> None:
    tools = {hook["entry"].split()[0].removeprefix(".venv/bin/") for hook in HOOKS}
    assert tools == set(re.findall(r"\$\(BIN\)/(ruff|lint-imports|mypy)\b", MAKEFILE))
    known = {Requirement(r).name for r in PROJECT["optional-dependencies"]["dev"]}
    assert {"ruff", "mypy", "import-linter"} <= known
    assert {hook["language"] for hook in HOOKS} == {"system"}


def test_the_citation_has_the_version_and_the_licence_of_the_package() -> None:
    assert (CITATION["version"], CITATION["license"]) == (PROJECT["version"], PROJECT["license"])
    assert (CITATION["title"], CITATION["authors"]) == (PROJECT["name"], [{"name": "the calibench authors"}])
    assert CITATION["keywords"] == PROJECT["keywords"]
    assert f"## {PROJECT['version']}" in (ROOT / "CHANGELOG.md").read_text()


@pytest.mark.parametrize("k", range(len(PAPERS)))
def test_the_papers_are_cited_as_their_data_say(k: int) -> None:
    cited: dict[str, Any] = CITATION["references"][k]
    [file] = (ROOT / "problems").rglob(f"{PAPERS[k]}.toml")
    paper = tomllib.loads(file.read_text())["paper"]
    names = [f"{a['given-names']} {a['family-names']}" for a in cited["authors"]]
    assert (cited["title"], names, cited["year"]) == (paper["title"], paper["authors"], paper["year"])
    assert paper["book"].startswith(cited["collection-title"])
    assert cited.get("isbn") == paper.get("isbn")
    assert f"{cited.get('start')}-{cited.get('end')}" == paper.get("pages", "None-None")
