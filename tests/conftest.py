"""Before the whole suite each worker compiles its share of the kernels, so that no two compile the same ones.

Likewise every other worker collects the tests from the last file to the first: it finds the second half of what Python
compiles, and pytest rewrites, kept by the others, and they find the first half. What is compiled is kept whatever the
environment says: the tests start many processes, and each would compile our modules anew.

The collection makes a million objects that stay: they are not looked through while it does.
"""

import gc
import importlib
import os
import sys

import pytest

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as `make test` has it: runs and direct calls add up in one order

gc.disable()  # until all tests are collected

WHOLE = 2000  # tests: of fewer, each compiles what it needs
SECONDS = {
    "arm_ur10": 32,
    "ga": 11,
    "sensor_zero": 10,
    "tracking_zero": 10,
    "pso": 6,
    "de": 6,
    "delta9": 4,
    "orthoglide6": 4,
}


def shares(workers):
    """Return the names that each of so many workers compiles: the next longest goes where least is to do."""
    names, busy = [[] for _ in range(workers)], [0] * workers
    for name, seconds in SECONDS.items():
        at = busy.index(min(busy))
        names[at].append(name)
        busy[at] += seconds
    return names


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    report = yield
    if report.result and isinstance(collector, pytest.Directory | pytest.Session) and _counts_backwards(collector):
        report.result = report.result[::-1]
    return report


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: (item.path, isinstance(item, pytest.DoctestItem)))  # workers must have one order


def _counts_backwards(collector):
    worker = getattr(collector.config, "workerinput", None)
    return worker is not None and int(worker["workerid"].removeprefix("gw")) % 2 == 1


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session):
    gc.freeze()  # a million objects of the collection, which no test drops, need not be looked through again
    gc.enable()
    worker = getattr(session.config, "workerinput", None)
    if worker is None or len(session.items) < WHOLE:
        return
    from calibench import optimizers, problems

    for name in shares(worker["workercount"])[int(worker["workerid"].removeprefix("gw"))]:
        registry = problems if name in problems.names() else optimizers
        registry.make(name).compile()


@pytest.fixture(autouse=True, scope="session")
def without_waits_for_the_disk():
    """Let files be written without waiting for the disk: no folder of a test outlives a power cut."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        yield


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    """Return a cache folder of its own, in which nothing is kept but the kernels, which take long to compile."""
    from calibench.core.compilation import compiled

    kernels, cache = compiled.cache_folder(), tmp_path / "cache"
    (cache / "calibench").mkdir(parents=True)
    (cache / "calibench" / kernels.name).symlink_to(kernels)
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    return cache


@pytest.fixture(scope="module")
def at_one_noise():
    """Let reports be without the searches at half and at twice the noise, which take two fifths of their time.

    For modules that ask for names and sizes: `discrepancy/test_partly.py` and those of pages ask for the others.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(importlib.import_module("calibench.discrepancy.procedure"), "_OTHERS", ())
        yield


@pytest.fixture(scope="module")
def without_formula():
    """Let reports of errors without a name be without formulas: for modules about the smooth functions."""
    with pytest.MonkeyPatch.context() as patch:
        module = importlib.import_module("calibench.discrepancy.procedure")
        patch.setattr(module, "with_formula", lambda ground, smooth, free, whole, seed: (smooth, None))
        yield
