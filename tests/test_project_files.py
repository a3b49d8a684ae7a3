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
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT, TOOL = PYPROJECT["project"], PYPROJECT["tool"]
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
    assert JOBS["elsewhere"]["needs"] == "dist"
    assert "make dist" in commands("dist")
    assert "*.whl" in commands("elsewhere")


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


def test_the_version_is_that_of_the_citation_alone() -> None:
    assert (PROJECT["dynamic"], TOOL["hatch"]["version"]["path"]) == (["version"], "CITATION.cff")
    assert CITATION["license"] == PROJECT["license"]
    assert (CITATION["title"], CITATION["authors"]) == (PROJECT["name"], [{"name": "the calibench authors"}])
    assert CITATION["keywords"] == PROJECT["keywords"]
    assert f"## {CITATION['version']}" in (ROOT / "CHANGELOG.md").read_text()


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


def test_the_recipe_for_conda_asks_for_what_the_package_asks_for() -> None:
    recipe = yaml.safe_load((ROOT / ".ci" / "conda" / "recipe.yaml").read_text())
    other = {"matplotlib": "matplotlib-base"}  # as conda-forge calls it

    def asked(requirements: list[str]) -> set[tuple[str, SpecifierSet]]:
        return {(other.get(r.name, r.name), r.specifier) for r in map(Requirement, requirements)}

    python = [f"python{PROJECT['requires-python']}"]
    assert asked(recipe["requirements"]["run"]) == asked(PROJECT["dependencies"] + python)
    assert asked(recipe["requirements"]["host"]) == asked([*PYPROJECT["build-system"]["requires"], "pip", *python])
    assert dict(s.split(" = ") for s in recipe["build"]["python"]["entry_points"]) == PROJECT["scripts"]
    assert recipe["about"]["license_file"] == PROJECT["license-files"]
    assert (recipe["about"]["license"], recipe["about"]["summary"]) == (PROJECT["license"], PROJECT["description"])
