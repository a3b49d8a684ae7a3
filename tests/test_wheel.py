"""Wheel, sdist and `pip install -e` of a clone without links, as Windows makes it, are the whole product."""

import hashlib
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from shutil import copytree, ignore_patterns
from urllib.parse import urljoin
from urllib.request import url2pathname

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

from calibench import bench, optimizers, problems

ROOT = Path(__file__).resolve().parents[1]
ROOMS = [path.name for path in (ROOT / "calibench").iterdir() if (ROOT / path.name / "__init__.py").exists()]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
INLINED = PYPROJECT["tool"]["calibench"]["inlined"]
DATA = (".j2", ".css", ".js", ".txt", ".json", ".toml", ".yaml", ".typed", ".csv", ".parquet")
OWN = "import numpy as np\n\n\nclass Bowl:\n    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)\n\n" \
    "    def __call__(self, x):\n        return float(x @ x)\n"  # fmt: skip
COMMANDS = """
import sys
from calibench.bench.cli import main
for line in ("list problems", "run problem=./own.py:Bowl optimizer=de budget=50 seeds=1", "status results/adhoc"):
    try:
        main(line.split())
    except SystemExit as ended:
        assert ended.code == 0, line
"""
IMPORTS = "from calibench import bench, discrepancy, optimizers, plot, problems, testing\n"
DIGEST = 'print(bench.execute(problems.make("sensor_zero"), optimizers.make("lm"), budget=9).row["code_digest"])'


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """Return a copy of the checkout in which each link is a file with the link's text, as git writes it there."""
    folder = tmp_path_factory.mktemp("clone")
    for name in ("calibench", *ROOMS):
        unwanted = ignore_patterns("__pycache__", *(ROOMS if name == "calibench" else ()))
        copytree(ROOT / name, folder / name, ignore=unwanted)
    for name in ("pyproject.toml", "README.md", "CHANGELOG.md", "CITATION.cff", *PYPROJECT["project"]["license-files"]):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes((ROOT / name).read_bytes())
    for name in ROOMS:
        (folder / "calibench" / name).write_text(f"../{name}")
    return folder


@pytest.fixture(scope="module")
def wheel(clone, tmp_path_factory):
    return built(WheelBuilder, clone, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def dist():
    """Return `.ci/dist.py` as a module."""
    spec = spec_from_file_location("dist", ROOT / ".ci" / "dist.py")
    spec.loader.exec_module(module := module_from_spec(spec))
    return module


def built(builder, source, to, version="standard"):
    (path,) = builder(str(source)).build(directory=str(to), versions=[version])
    return Path(path)


def give(wheel, folder, commands):
    """Install `wheel` in a fresh environment, run Python there, in a folder with files of our names; return lines."""
    env, here = folder / "env", folder / "here"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", env], check=True)
    python = env / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    pip = [sys.executable, "-m", "pip", "--python", python, "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, "install", "--no-deps", "--no-index", "--no-compile", wheel], check=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(env)}))
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib"))  # NumPy and the rest, as they are here
    for room in ROOMS:
        (here / room).mkdir(parents=True)
        (here / room / "__init__.py").write_text("raise RuntimeError('this is mine')\n")
    (here / "own.py").write_text(OWN)
    given = os.environ | {"NUMBA_DISABLE_JIT": "1"}  # ten seconds of compiling say nothing of what is installed
    done = subprocess.run([python, "-c", commands], cwd=here, env=given, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    listed = subprocess.run([python.with_name("bench"), "list", "optimizers"], cwd=here, capture_output=True, text=True)
    assert "\nnlopt_LN_BOBYQA" in listed.stdout, listed.stderr
    return done.stdout.splitlines()


def test_every_room_of_the_checkout_is_taken_from_where_it_stands():
    targets = PYPROJECT["tool"]["hatch"]["build"]["targets"]
    assert targets["wheel"]["sources"] == {room: f"calibench/{room}" for room in ROOMS}
    assert sorted(targets["wheel"]["exclude"]) == sorted(f"/calibench/{room}" for room in ROOMS)


def test_modules_templates_style_sheets_the_schema_and_the_mark_of_types_are_in_the_wheel(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    here = {
        f"calibench/{path.relative_to(ROOT).as_posix()}"
        for room in ROOMS
        for path in (ROOT / room).rglob("*")
        if path.suffix in (*DATA, ".py") and "__pycache__" not in path.parts
    }
    assert {path.rpartition(".")[2] for path in here} >= {"py", "j2", "css", "js", "txt", "json", "toml", "yaml"}
    assert here <= names
    assert {"calibench/py.typed", "calibench/plot/__init__.py", "calibench/testing/__init__.py"} <= names
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"calibench"}


def test_what_others_wrote_is_listed_and_its_licence_is_in_the_wheel(wheel):
    listed = {Path(file) for one in INLINED for file in (*one["files"], one.get("text", "LICENSE"))}
    assert all((ROOT / file).exists() for file in listed)
    texts = PYPROJECT["project"]["license-files"]
    assert {one["text"] for one in INLINED if "text" in one} == set(texts) - {"LICENSE"}
    names = zipfile.ZipFile(wheel).namelist()
    assert all(any(name.endswith(f".dist-info/licenses/{text}") for name in names) for text in texts)
    for room in (*ROOMS, "docs", "examples", "tests"):
        for path in (path for path in (ROOT / room).rglob("*") if path.suffix not in (".pyc", ".png", ".parquet")):
            if path.is_file() and re.search(rb"copyright \(c\)|public domain\)", path.read_bytes().lower()):
                owner = path.relative_to(ROOT)
                assert listed & {owner, *owner.parents} or path == Path(__file__), owner
    assert all(one["version"].encode() in (ROOT / one["files"][0]).read_bytes()[:99] for one in INLINED[:2])


def test_the_list_of_parts_names_the_package_its_dependencies_and_what_is_inlined(dist):
    bom = dist.parts({"calibench.whl": "0" * 64}, "2026-01-01T00:00:00+00:00")
    components = bom["components"]
    assert (bom["bomFormat"], bom["specVersion"], bom["version"]) == ("CycloneDX", "1.6", 1)
    assert bom["metadata"]["component"]["version"] == dist.VERSION
    for one in (bom["metadata"]["component"], *components):
        assert one["type"] == "library"
        assert one["name"]
        assert one["licenses"]
    refs = [one["bom-ref"] for one in components]
    assert len(set(refs)) == len(refs)
    graph = {one["ref"]: set(one["dependsOn"]) for one in bom["dependencies"]}
    assert {ref for needed in graph.values() for ref in needed} == set(refs)
    assert {one["name"] for one in components if "evidence" in one} == {one["name"] for one in INLINED}
    locked = re.findall(r"(?m)^(\S+)==(\S+)", (ROOT / "requirements.lock").read_text())
    fixed = {(one["name"], one["version"]): one["hashes"] for one in components if "purl" in one}
    assert set(fixed) <= set(locked)
    assert {"numpy", "hydra-core", "antlr4-python3-runtime", "pyyaml"} <= {name for name, _ in fixed}
    assert all(re.fullmatch("[0-9a-f]{64}", one["content"]) for hashes in fixed.values() for one in hashes)


def test_pages_of_the_index_lead_to_their_files(dist, wheel, tmp_path):
    (kept := tmp_path / "files").mkdir()
    (kept / wheel.name).write_bytes(wheel.read_bytes())
    (kept / "Some.Thing-1.0.tar.gz").touch()
    dist.write_pages(kept, simple := tmp_path / "simple")
    assert re.findall('href="(.*?)"', (simple / "index.html").read_text()) == ["some-thing/", "calibench/"]
    page = simple / "calibench" / "index.html"
    [(link, python)] = re.findall('href="(.*?)" data-requires-python="(.*?)"', page.read_text())
    file, _, digest = urljoin(page.as_uri(), link).partition("#sha256=")
    assert Path(url2pathname(file.removeprefix("file:"))) == kept / wheel.name
    assert (digest, python) == (hashlib.sha256(wheel.read_bytes()).hexdigest(), "&gt;=3.11")


@pytest.mark.parametrize("links", [False, True])
def test_the_sdist_gives_the_same_wheel_to_the_byte(clone, wheel, links, tmp_path):
    with tarfile.open(built(SdistBuilder, ROOT if links else clone, tmp_path)) as archive:
        archive.extractall(tmp_path, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))  # from 3.11.4
    (source,) = (path for path in tmp_path.iterdir() if path.is_dir())
    again = built(WheelBuilder, source, tmp_path)
    assert again.read_bytes() == wheel.read_bytes()


def test_what_each_python_compiles_comes_into_the_wheel_and_not_into_the_sdist(dist, clone, tmp_path, monkeypatch):
    def installed(folder, python, *_):
        return lambda command: (command[-1] / f"{python}.zip").touch(), tmp_path, 0.0, 0.0

    monkeypatch.setattr(dist, "installed", installed)
    monkeypatch.setattr(dist, "git", lambda *_: b"1700000000")
    sdist = built(SdistBuilder, clone, to := tmp_path / "dist")
    dist.bring_kernels(to, tmp_path, ["python3.11", "python3.13"])
    [wheel] = to.glob("*.whl")
    came = {name for name in zipfile.ZipFile(wheel).namelist() if name.endswith(".zip")}
    assert came == {f"calibench/core/compilation/kernels/python3.{n}.zip" for n in (11, 13)}
    with tarfile.open(sdist) as archive:
        assert not [name for name in archive.getnames() if "kernels/" in name or name.endswith(".zip")]


def test_the_wheel_is_whole_among_a_users_own_folders_of_our_names(wheel, tmp_path):
    lines = give(wheel, tmp_path, IMPORTS + COMMANDS)
    assert any(line.startswith("sensor_zero") for line in lines)


def test_an_editable_clone_is_whole_and_its_code_has_the_same_digest(clone, tmp_path, capsys):
    lines = give(built(WheelBuilder, clone, tmp_path, "editable"), tmp_path, IMPORTS + DIGEST)
    exec(DIGEST, {"bench": bench, "optimizers": optimizers, "problems": problems})
    assert capsys.readouterr().out == f"{lines[-1]}\n"
