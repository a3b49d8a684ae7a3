"""Machine code that came with the installation is loaded where it fits, to the bit, and refused where it does not."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

from calibench.core.compilation import shipped
from tests.few import few

ROOT = Path(__file__).resolve().parents[2]
LEVEL = shipped.level()
pytestmark = pytest.mark.skipif(LEVEL is None, reason="this processor has no level, or numba is told of another")

VALUE = """
from calibench.core.compilation import lanes
from calibench.core.compilation.compiled import cache_folder
print(*(part.hex() for part in lanes.cos_sin(1.25)))
print(sum(lanes.cos_sin.stats.cache_hits.values()), len(list(cache_folder().rglob("*.nb?"))))
"""
PACK = f"""
from calibench.core.compilation import shipped
shipped.FOLDER.mkdir()
shipped.pack(cache_folder(), {LEVEL!r}, ["0123456789ab"], shipped.FOLDER)
"""
WITHOUT_FMA = """
import llvmlite.binding as llvm
has = llvm.get_host_cpu_features
def lacks():
    features = has()
    features["fma"] = False
    return features
llvm.get_host_cpu_features = lacks
"""


def python(code, source, cache, **environment):
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    own = {"PYTHONPATH": str(source), "XDG_CACHE_HOME": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=source, env=inherited | own | environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Return the folder of an installation with an archive, and what its kernel returns where it was compiled."""
    source = tmp_path_factory.mktemp("installation")
    shutil.copytree(ROOT / "core", source / "calibench" / "core", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "calibench" / "__init__.py", source / "calibench" / "__init__.py")
    told = {"NUMBA_CPU_NAME": LEVEL, "NUMBA_CPU_FEATURES": shipped.LEVELS[LEVEL][1]}
    value, counts = python(VALUE + PACK, source, tmp_path_factory.mktemp("cache"), **told)
    assert counts.startswith("0 ")
    return source, value


@pytest.fixture
def installation(built, tmp_path):
    """Return a copy of it that a test may change, and the one archive in it."""
    shutil.copytree(built[0], tmp_path / "copy")
    [archive] = (tmp_path / "copy" / "calibench" / "core" / "compilation" / "kernels").iterdir()
    return tmp_path / "copy", archive


def test_it_is_loaded_with_an_empty_cache_has_the_same_bits_and_nothing_is_written(built, tmp_path):
    code = VALUE + "from calibench.core.compilation.shipped import modules\nprint(modules())"
    assert python(code, built[0], tmp_path) == [built[1], "1 0", "frozenset({'0123456789ab'})"]


def test_no_path_of_the_machine_that_compiled_it_is_in_it(built, installation):
    with ZipFile(installation[1]) as archive:
        texts = [archive.read(name) for name in archive.namelist()]
    assert len(texts) > 1
    assert not any(str(built[0]).encode() in text or b"/site-packages/" in text for text in texts)


def other_source(source, archive):
    with (source / "calibench" / "core" / "compilation" / "lanes.py").open("a") as file:
        file.write("another = 1\n")


def other_numba(source, archive):
    archive.rename(archive.with_name(re.sub("numba-[^-]+", "numba-0.1.0", archive.name)))


def cut_off(source, archive):
    os.truncate(archive, archive.stat().st_size // 2)


def damage(source, archive):
    with ZipFile(archive) as whole:
        texts = {name: whole.read(name) for name in whole.namelist()}
    with ZipFile(archive, "w") as half:
        for name, text in texts.items():
            half.writestr(name, text[: len(text) // 2])


@pytest.mark.parametrize("change", few(2, [other_source, other_numba, cut_off, damage]))
def test_what_does_not_fit_or_cannot_be_read_is_compiled_here(built, installation, tmp_path, change):
    change(*installation)
    value, counts = python(VALUE, installation[0], tmp_path / "cache")
    assert value == built[1]
    assert re.fullmatch("0 [1-9][0-9]*", counts)


@pytest.mark.parametrize(("before", "told"), [(WITHOUT_FMA, {}), ("", {"NUMBA_CPU_NAME": "x86-64-v3"})])
def test_a_processor_without_these_instructions_or_the_users_choice_refuses_it(built, tmp_path, before, told):
    value, counts = python(before + VALUE, built[0], tmp_path, **told)
    assert (value, counts[:2]) == (built[1], "0 ")
