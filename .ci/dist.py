"""`make dist`: the files of a release, their list of parts, and a trial of both where nothing else can be reached.

1. The commit is exported, sdist and wheel are built, and both once more from that sdist: the same bytes, or it ends.
2. An index in a folder, static pages (PEP 503): our two files, and for each Python what the lock has and the newest.
3. Each Python, with the versions of the lock, compiles kernels (kernels.py), and the wheel is built with them.
4. A list of parts (SBOM, CycloneDX): the package, its dependencies by requirements.lock, what others wrote in it.
5. From that index alone, into fresh environments of each Python with an empty HOME: install, run, discover, report.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
import zipfile
from functools import partial
from html import escape
from importlib.metadata import distribution
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.metadata.core import ProjectMetadata
from hatchling.plugin.manager import PluginManager
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name, parse_sdist_filename, parse_wheel_filename

ROOT = Path(__file__).resolve().parents[1]
PROJECT: Any = ProjectMetadata(str(ROOT), PluginManager())
NAME, VERSION, CORE = PROJECT.core.name, PROJECT.version, PROJECT.core
TOOL = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]
SDIST = TOOL["hatch"]["build"]["targets"]["sdist"]["only-include"]
FROM = ("pyproject.toml", "requirements.lock", ".gitignore", ".ci", *SDIST)
TRIALS = (("wheel", "lock"), ("wheel", "newest"), ("sdist", "newest"))
HEAD = ("Python", "file", "versions", "seconds of install", "of commands", "MB installed")
NOWHERE = "http://127.0.0.1:9"  # the proxy of a trial: what is not in the index of the folder is not reached
SPDX = re.compile(r"(?:(?:^| (?:AND|OR|WITH) )(?:MIT|Zlib|\w+(?:-[\w.]+)+|0BSD))+")
COMMANDS = (
    "--version", "list problems", "run problem=full12 optimizer=lm budget=500 seeds=1",
    "discover machine=gpm2002 data=demo_backlash", "report results/adhoc",
)  # fmt: skip


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--pythons", nargs="+", default=found_pythons(), help="default: the oldest and the newest here")
    words.add_argument("--index", type=Path, default=Path("build", "index"), help="where downloads are kept")
    asked = words.parse_args()
    index = asked.index.resolve()
    files(dist := ROOT / "dist")
    make_index(index, asked.pythons)
    bring_kernels(dist, index, asked.pythons)
    publish(dist, index)
    describe(dist)
    print(*(f"| {' | '.join(row)} |" for row in (HEAD, ["---"] * len(HEAD))), sep="\n", flush=True)
    for python, (file, versions) in itertools.product(asked.pythons, TRIALS):
        print(f"| {' | '.join(trial(python, file, versions, index))} |", flush=True)


def files(to: Path) -> None:
    """Put sdist and wheel of the commit into the folder `to`, which holds nothing else afterwards."""
    if changed := git("status", "--porcelain", "-uall", "--", *FROM).decode():
        sys.exit(f"make dist: these are not as the last commit has them; commit or remove them:\n{changed}")
    with TemporaryDirectory() as folder:
        tree, packed = Path(folder, "commit"), Path(folder, "commit.tar")
        packed.write_bytes(git("archive", "--format=tar", "HEAD"))
        shutil.unpack_archive(packed, tree)
        build_twice(tree, Path(folder))
        shutil.rmtree(to, ignore_errors=True)
        shutil.copytree(Path(folder, "first"), to)


def build_twice(tree: Path, folder: Path) -> None:
    """Build sdist and wheel from `tree` into `folder`/first, both again from that sdist, and compare their bytes."""
    for turn in ("first", "again"):
        build(tree, folder / turn)
        tree = unpacked(folder / turn, folder / "sdist")
    for first in (folder / "first").iterdir():
        if first.read_bytes() != (folder / "again" / first.name).read_bytes():
            sys.exit(f"make dist: {first.name}: built again from the sdist it has other bytes")


def build(tree: Path, to: Path, *words: str) -> None:
    dated = os.environ | {"SOURCE_DATE_EPOCH": git("log", "-1", "--format=%ct").decode().strip()}
    command = [sys.executable, "-m", "hatchling", "build", *words, "-d", str(to)]
    subprocess.run(command, cwd=tree, env=dated, check=True, capture_output=True)


def unpacked(files: Path, to: Path) -> Path:
    """Return the folder that the sdist among `files` gives."""
    [sdist] = files.glob("*.tar.gz")
    shutil.unpack_archive(sdist, to)
    [tree] = to.iterdir()
    return tree


def bring_kernels(dist: Path, index: Path, pythons: list[str]) -> None:
    """Build the wheel in `dist` again, with what each Python compiles of the one in `index`; the sdist has none."""
    with TemporaryDirectory() as folder:
        tree = unpacked(dist, Path(folder, "sdist"))
        (kernels := tree / "core" / "compilation" / "kernels").mkdir()
        for number, python in enumerate(pythons):
            do, programs, *_ = installed(Path(folder, str(number)), python, "wheel", "lock", index)
            do([programs / "python", ROOT / ".ci" / "kernels.py", kernels])
        build(tree, dist, "-t", "wheel")


def describe(dist: Path) -> None:
    """Write the list of parts beside the files, and print the digest of each."""
    hashes = {path.name: digest(path) for path in sorted(dist.iterdir())}
    moment = git("log", "-1", "--format=%cI").decode().strip()
    (dist / f"{NAME}-{VERSION}.cdx.json").write_text(json.dumps(parts(hashes, moment), indent=1, sort_keys=True))
    print("\n".join(f"{path}  {digest(path)}" for path in sorted(dist.iterdir())), flush=True)


def git(*words: str) -> bytes:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True).stdout


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def parts(released: dict[str, str], moment: str) -> dict[str, Any]:
    """Return the list of parts, CycloneDX 1.6. `released` are names and SHA-256 of our files."""
    ours = part(NAME, VERSION, CORE.license_expression, f"pkg:pypi/{NAME}@{VERSION}")
    ours["externalReferences"] = [
        {"type": "distribution", "url": u, "hashes": hashed([h])} for u, h in released.items()
    ]
    listed = []
    for one in TOOL["calibench"]["inlined"]:
        listed.append(part(one["name"], one.get("version", ""), one["licence"], f"inlined:{one['name']}"))
        listed[-1]["externalReferences"] = [{"type": "website", "url": one["source"]}]
        listed[-1]["evidence"] = {"occurrences": [{"location": file} for file in one["files"]]}
    needs, lock = closure(), lock_of()
    refs = {name: [f"pkg:pypi/{name}@{line.split()[0].partition('==')[2]}" for line in lock[name]] for name in needs}
    others = [other for name in direct(CORE.dependencies) for other in refs[name]]
    graph = {ours["bom-ref"]: [one["bom-ref"] for one in listed] + others}
    for name, ref, line in ((of, *pair) for of in needs for pair in zip(refs[of], lock[of])):
        wanted, *hashes = line.split("--hash=sha256:")
        listed.append(part(name, ref.partition("@")[2], licence(name), ref) | {"purl": ref, "hashes": hashed(hashes)})
        listed[-1]["properties"] = [{"name": "where", "value": str(Requirement(wanted).marker or "everywhere")}]
        graph[ref] = [other for need in needs[name] for other in refs[need]]
    return {
        "bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1,
        "metadata": {"timestamp": moment, "component": ours},
        "components": listed,
        "dependencies": [{"ref": ref, "dependsOn": on} for ref, on in graph.items()],
    }  # fmt: skip


def part(name: str, version: str, licence: str, ref: str) -> dict[str, Any]:
    said = {"expression": licence} if SPDX.fullmatch(licence) else {"license": {"name": licence}}
    return {"type": "library", "name": name, "version": version, "bom-ref": ref, "licenses": [said]}


def hashed(digests: list[str]) -> list[dict[str, str]]:
    return [{"alg": "SHA-256", "content": one.strip()} for one in digests]


def licence(name: str) -> str:
    """Return the licence that an installed package states: by SPDX if anywhere, by its classifier, or in a line."""
    about = distribution(name).metadata
    first = (about.get("License") or "").strip().partition("\n")[0]
    classified = [line.rpartition(" :: ")[2] for line in about.get_all("Classifier", []) if line.startswith("License")]
    ways = [about.get("License-Expression") or "", first, ", ".join(classified)]
    return next((way for way in ways if SPDX.fullmatch(way)), ways[2] or f"{first} licence")


def direct(requirements: list[str]) -> list[str]:
    """Return the names that are needed here, of those without an extra."""
    wanted = (r for r in map(Requirement, requirements) if r.marker is None or r.marker.evaluate({"extra": ""}))
    return sorted({canonicalize_name(r.name) for r in wanted})


def closure() -> dict[str, list[str]]:
    """Return each package that the base needs, and what that one needs."""
    found: dict[str, list[str]] = {}
    todo = direct(CORE.dependencies)
    while todo:
        if (name := todo.pop()) not in found:
            found[name] = direct(distribution(name).requires or [])
            todo += found[name]
    return dict(sorted(found.items()))


def lock_of() -> dict[str, list[str]]:
    """Return the lines of requirements.lock by name: several where versions differ by Python."""
    lines: dict[str, list[str]] = {}
    for line in (ROOT / "requirements.lock").read_text().replace("\\\n", "").splitlines():
        if line[:1].isalnum():
            lines.setdefault(canonicalize_name(line.partition("==")[0]), []).append(line)
    return lines


def found_pythons() -> list[str]:
    """Return the oldest and the newest Python on the path that the package allows."""
    names = filter(shutil.which, (f"python3.{n}" for n in range(40) if CORE.python_constraint.contains(f"3.{n}")))
    works = [name for name in names if not subprocess.run([name, "-V"], capture_output=True).returncode]
    return sorted({works[0], works[-1]})


def make_index(index: Path, pythons: list[str]) -> None:
    """Fill `index`: files from the ordinary index, once, and ours; the pages; the versions of the lock."""
    (kept := index / "files").mkdir(parents=True, exist_ok=True)
    lines = list(itertools.chain(*map(lock_of().__getitem__, closure())))
    (index / "lock.txt").write_text("\n".join(lines))
    (index / "versions.txt").write_text("\n".join(line.partition("--hash")[0] for line in lines))
    build = [*PROJECT.build.requires, "setuptools", "wheel"]  # these two build a dependency that has no wheel
    for python in pythons:
        fetch = [python, "-m", "pip", "download", "-q", "--no-cache-dir", "-d", str(kept)]
        subprocess.run([*fetch, "--require-hashes", "-r", str(index / "lock.txt")], check=True)
        subprocess.run([*fetch, *CORE.dependencies, *build], check=True)
    publish(ROOT / "dist", index)


def publish(dist: Path, index: Path) -> None:
    """Put our files into `index` in place of earlier ones, and write its pages."""
    for old in (kept := index / "files").glob(f"{NAME}-*"):
        old.unlink()
    for path in (*dist.glob("*.whl"), *dist.glob("*.tar.gz")):
        shutil.copy(path, kept)
    write_pages(kept, index / "simple")


def write_pages(kept: Path, simple: Path) -> None:
    """Write the pages of PEP 503 for the files in `kept`; links are relative, so that the folder can be moved."""
    links: dict[str, list[str]] = {}
    for path in sorted(kept.iterdir()):
        asks = ""
        if path.suffix == ".whl":
            name = parse_wheel_filename(path.name)[0]
            with zipfile.ZipFile(path) as wheel:
                [about] = (member for member in wheel.namelist() if re.fullmatch(r"[^/]+\.dist-info/METADATA", member))
                for needed in re.findall(r"(?m)^Requires-Python: *(.*?)\s*$", wheel.read(about).decode()):
                    asks = f' data-requires-python="{escape(needed)}"'
        else:
            name = parse_sdist_filename(path.name)[0]
        link = f'<a href="../../{kept.name}/{path.name}#sha256={digest(path)}"{asks}>{path.name}</a><br>'
        links.setdefault(name, []).append(link)
    shutil.rmtree(simple, ignore_errors=True)
    for name, lines in {**links, "": [f'<a href="{name}/">{name}</a><br>' for name in links]}.items():
        (simple / name).mkdir(parents=True, exist_ok=True)
        (simple / name / "index.html").write_text("\n".join(["<!DOCTYPE html>", *lines]))


def trial(python: str, file: str, versions: str, index: Path) -> tuple[str, ...]:
    """Install `file` from `index` alone and use it, each time from nothing; return a row of the table."""
    said = subprocess.run([python, "-V"], check=True, capture_output=True, text=True).stdout.split()[1]
    with TemporaryDirectory() as folder:
        do, programs, *numbers = installed(Path(folder), python, file, versions, index)
        begun = time.monotonic()
        for command in COMMANDS:
            do([programs / "bench", *command.split()])
        if not Path(folder, "home", "here", "results", "adhoc", "report.html").is_file():
            sys.exit("make dist: bench report wrote no page")
        numbers.insert(1, time.monotonic() - begun)
    return said, file, versions, *(f"{number:.0f}" for number in numbers)


def installed(folder: Path, python: str, file: str, versions: str, index: Path) -> tuple[Any, Path, float, float]:
    """Install `file` from `index` alone into `folder`; return what runs commands, their folder, seconds, MB."""
    fresh, home = folder / "env", folder / "home"
    (here := home / "here").mkdir(parents=True)
    env = {
        "PATH": os.environ["PATH"], "HOME": str(home), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1",
        "http_proxy": NOWHERE, "https_proxy": NOWHERE, "PIP_INDEX_URL": (index / "simple").as_uri(),
        "PIP_CONFIG_FILE": os.devnull, "PIP_NO_CACHE_DIR": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1",
    }  # fmt: skip
    subprocess.run([python, "-m", "venv", fresh], check=True)
    size = lambda: sum(path.stat().st_size for path in fresh.rglob("*") if not path.is_symlink())  # noqa: E731
    before, begun = size(), time.monotonic()
    only = ["--only-binary" if file == "wheel" else "--no-binary", NAME]
    chosen = ["-c", str(index / "versions.txt")] if versions == "lock" else []
    do = partial(subprocess.run, cwd=here, env=env, check=True, stdout=subprocess.DEVNULL)
    do([fresh / "bin" / "python", "-m", "pip", "install", *only, *chosen, f"{NAME}=={VERSION}"])
    return do, fresh / "bin", time.monotonic() - begun, (size() - before) / 1e6


if __name__ == "__main__":
    main()
