"""`bench doctor`: what a bug report needs, and what is wrong with an installation."""

import json
from importlib.metadata import version

from calibench.bench.commands import doctor
from calibench.core.compilation import shipped


def test_versions_machine_and_what_is_missing_are_told(run_bench, own_cache):
    code, out, err = run_bench("doctor --json")
    found = json.loads(out)
    assert (code, err, found["wrong"]) == (0, "", [])
    assert f"numpy {version('numpy')}" in found["libraries"][0]
    assert "sql" in found["extras"][0]
    assert "cores" in found["system"][0]
    assert "free" in found["disk"][0]
    told = run_bench("doctor")[1]
    assert all(line in told for lines in found.values() for line in lines if "GB free" not in line)


def test_a_package_that_does_not_load_is_named(run_bench, own_cache, monkeypatch):
    def import_module(name):
        if name == "nlopt":
            raise ImportError("libnlopt.so: wrong ELF class\nsecond line")

    monkeypatch.setattr(doctor, "import_module", import_module)
    code, out, _ = run_bench("doctor")
    assert code == 1
    assert "wrong       nlopt cannot be imported: ImportError: libnlopt.so: wrong ELF class\n" in out


def test_machine_code_of_the_installation_that_does_not_fit_is_told(run_bench, own_cache, monkeypatch, tmp_path):
    assert json.loads(run_bench("doctor --json")[1])["kernels"][1] == "none came with the installation"
    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    (tmp_path / "py39-numba-0.1.0-llvmlite-0.1.0-x86-64-v3.zip").touch()
    shipped.archive.cache_clear()
    told = json.loads(run_bench("doctor --json")[1])["kernels"][1]
    assert told == "none that came with the installation fits: it has py39-numba-0.1.0-llvmlite-0.1.0-x86-64-v3"
    shipped.pack(tmp_path, str(shipped.level()), [], tmp_path)
    shipped.archive.cache_clear()
    told = json.loads(run_bench("doctor --json")[1])["kernels"][1]
    shipped.archive.cache_clear()
    assert told == f"0 came with the installation, for {shipped.level()}, and are loaded where none is compiled here"


def test_words_are_refused(run_bench):
    assert run_bench("doctor here")[0] == 2
