"""What the site shows beside the files of docs/: README.md and others from the root, and what `bench` lists.

MkDocs calls these hooks. A page reads the same in a viewer of the repository: its links are those of the repository,
and are turned here into those of the site. A link to a file that is no page becomes plain text with the file's name.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.architecture import files_listed  # noqa: E402

FROM_ROOT = {
    "index.md": "README.md",
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
    "examples.md": "examples/README.md",
}  # page of the site -> file of the repository
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")


def on_config(config: Any) -> Any:
    """Leave out of the navigation the pages that are still to come."""
    missing = {page for page in config.extra.get("coming", []) if not (Path(config.docs_dir) / page).exists()}
    config.nav = _without(config.nav, missing)
    return config


def _without(nav: list[Any], missing: set[str]) -> list[Any]:
    kept: list[Any] = []
    for entry in nav:
        if isinstance(entry, str):
            kept += [entry] * (entry not in missing)
            continue
        [(title, content)] = entry.items()
        if isinstance(content, list):
            kept.append({title: _without(content, missing)})
        elif content not in missing:
            kept.append(entry)
    return kept


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are no files of docs/."""
    for page, source in FROM_ROOT.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        if page == "index.md":
            text = text.replace("\n## ", f"\n{_doors(text)}\n\n## ", 1)
        if page == "examples.md":
            text += "".join(_scripts())
        files.append(File.generated(config, page, content=text))
    files.append(File.generated(config, "files.md", content=f"# Every file\n\n{files_listed()}\n"))
    for page, text in reference():
        files.append(File.generated(config, f"reference/{page}", content=text))
    return files


def _doors(text: str) -> str:
    """Return buttons to the first two sections: whom this is for."""
    first = re.findall(r"^## (.+)$", text, flags=re.MULTILINE)[:2]
    places = [re.sub(r"[^a-z0-9]+", "-", title.lower()) for title in first]
    return " ".join(f"[{title}](#{place}){{ .md-button .md-button--primary }}" for title, place in zip(first, places))


def _scripts() -> Iterator[str]:
    for script in sorted((ROOT / "examples").glob("*.py")):
        yield f"\n## `{script.name}`\n\n```python\n{script.read_text(encoding='utf-8')}```\n"


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Turn the links of the repository into those of the site."""
    uri = page.file.src_uri
    if uri.startswith("reference/"):
        return markdown
    here = PurePosixPath(FROM_ROOT.get(uri, f"docs/{uri}")).parent
    pages = {source: target for target, source in FROM_ROOT.items()}
    parts = re.split(r"(^ *```.*?^ *```[^\n]*$)", markdown, flags=re.MULTILINE | re.DOTALL)

    def turned(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        if re.match(r"[a-z]+:|#|<", target):
            return found[0]
        path, mark, anchor = target.partition("#")
        repository = os.path.normpath(here / path)
        if repository.startswith("docs/"):
            return f"{picture}[{words}]({repository.removeprefix('docs/')}{mark}{anchor})"
        if repository in pages:
            return f"[{words}]({pages[repository]}{mark}{anchor})"
        if not (ROOT / repository).exists():
            return found[0]  # MkDocs tells of it
        return f"{words} (`{repository}`)" if words.strip("`") != repository else f"`{repository}`"

    return "".join(part if i % 2 else LINK.sub(turned, part) for i, part in enumerate(parts))


def reference() -> Iterator[tuple[str, str]]:
    """Yield (page, text) of what the command line knows: the commands, and what there is."""
    told = f"``` {{.text .unfolded}}\n{_bench('--help')}```\n"  # its columns are no columns where lines are folded
    yield "commands.md", f"---\nhide: [toc]\n---\n# Commands\n\n`bench` and `calibench` are one command.\n\n{told}"
    yield "list-problems.md", _listed("Problems", "problems", "bench run problem=NAME problem.OPTION=VALUE ...")
    yield (
        "list-optimizers.md",
        _listed("Optimisers", "optimizers", "bench run optimizer=NAME optimizer.OPTION=VALUE ...") + _left_out(),
    )


def _listed(title: str, kind: str, command: str) -> str:
    """Return what ``bench list`` knows of a kind, a section an entry."""
    parts = [f"# {title}\n\n`{command}`\n"]
    entries = json.loads(_bench("list", kind, "--json"))
    for entry in entries:
        parts.append(f"## `{entry['name']}`\n\n{entry['about']}\n")
        if told := _traits(entry.get("traits", {})):
            parts.append(f"*{told}*\n")
        if entry["options"]:
            rows = [_option(option["text"]) for option in entry["options"]]
            parts.append("\n".join(["| option | default | values |", "| --- | --- | --- |", *rows, ""]))
    return "\n".join(parts)


def _left_out() -> str:
    entries = json.loads(_bench("list", "optimizers", "--all", "--json"))
    rows = [f"| `{entry['name']}` | {entry['about']} |" for entry in entries if entry.get("left_out")]
    said = ["", "## Left out", "", "What a library has and cannot be run honestly here, with the reason.", ""]
    return "\n".join([*said, "| method | reason |", "| --- | --- |", *rows, ""])


def _traits(traits: dict[str, Any]) -> str:
    told = [name.replace("_", " ") for name, value in traits.items() if value is True]
    if traits.get("minimum_budget", 1) > 1:
        told.append(f"minimum budget {traits['minimum_budget']}")
    return ", ".join(told)


def _option(text: str) -> str:
    name, _, rest = text.partition("=")
    default, _, values = rest.partition(" (")
    shown = values.removesuffix(")").replace("|", ", ")
    return f"| `{name}` | `{default}` | {shown} |"


def _bench(*words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "calibench", *words], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout
