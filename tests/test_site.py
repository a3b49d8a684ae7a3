"""The site's navigation names every page and no page that is missing, and nothing in it is fetched from elsewhere."""

from __future__ import annotations

import importlib
import re
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
SITE = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
PAGES = (ROOT / "docs" / "_site" / "pages.py").read_text()
FROM_ROOT = dict(re.findall(r'^    "(\w+\.md)": "([\w/]+\.md)",$', PAGES, re.MULTILINE))
MADE = {f"reference/{name}" for name in re.findall(r'"((?:commands|list-[a-z]+)\.md)"', PAGES)}
REFERENCE = sorted((ROOT / "docs" / "reference").glob("[!i]*.md"))
LINKED = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(ROOT / "docs").glob("*.md"),
    *(ROOT / "examples").glob("*.md"),
]


def named(nav: Any) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    return [page for entry in (nav if isinstance(nav, list) else nav.values()) for page in named(entry)]


def anchors(page: str) -> set[str]:
    heads = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", page, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", head.lower())).strip("-") for head in heads}


def test_the_navigation_names_every_page_once() -> None:
    docs = ROOT / "docs"
    written = {path.relative_to(docs).as_posix() for path in docs.rglob("*.md")}
    told = named(SITE["nav"])
    assert len(told) == len(set(told))
    assert written <= set(told)
    assert set(told) - written == set(FROM_ROOT) | {"files.md"} | MADE | (set(SITE["extra"]["coming"]) - written)


@pytest.mark.parametrize("page", REFERENCE, ids=lambda path: path.stem)
def test_the_reference_has_every_public_name(page: Path) -> None:
    text = page.read_text()
    package = importlib.import_module(text.splitlines()[0].removeprefix("# "))
    public = [name for name in package.__all__ if not isinstance(getattr(package, name), ModuleType)]
    assert sorted(re.findall(r"^(?:::: [\w.]*\.|\| `)(\w+)", text, re.MULTILINE)) == sorted(public)


def test_pages_from_the_root_are_there() -> None:
    assert FROM_ROOT["index.md"] == "README.md"
    assert all((ROOT / source).is_file() for source in FROM_ROOT.values())


@pytest.mark.parametrize("page", LINKED, ids=lambda path: path.name)
def test_a_link_leads_to_a_file_and_a_heading_in_a_viewer_of_the_repository(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists() or file.name in SITE["extra"]["coming"], target
        if anchor:
            assert anchor in anchors(file.read_text()), target


def test_nothing_is_fetched_from_elsewhere() -> None:
    assert SITE["theme"]["font"] is False
    assert "offline" in SITE["plugins"]
    for asked in (*SITE["extra_css"], *SITE["extra"]["polyfills"]):
        assert (ROOT / SITE["theme"]["custom_dir"] / asked).is_file(), asked
    assert any(
        "iframe-worker" in script for script in SITE["extra"]["polyfills"]
    )  # else the plugin names one elsewhere
    assert not {"repo_url", "extra_javascript", "analytics"} & (set(SITE) | set(SITE["extra"]))


def test_the_tools_of_the_site_are_an_extra_that_developers_do_not_need() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    docs = [Requirement(one) for one in extras["docs"]]
    assert {one.name for one in docs} == {"mkdocs", "mkdocs-material", "mkdocstrings"}
    assert all({bound.operator for bound in one.specifier} == {">=", "<"} for one in docs)
    assert not {one.name for one in docs} & {Requirement(one).name for one in extras["dev"]}
    assert "mkdocs" not in re.findall(r"^([\w.-]+)==", (ROOT / "requirements.lock").read_text(), re.MULTILINE)
    assert "mkdocs build --quiet --strict" in (ROOT / "Makefile").read_text()
