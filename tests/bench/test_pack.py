"""A pack goes on elsewhere with all its finished runs; what is made to do harm is one line, and writes nothing."""

import json
import os
import shutil
import stat
import zipfile
from hashlib import blake2b
from pathlib import Path

import pytest

from calibench.bench.cli import main
from calibench.bench.store.manifest import read_notes
from calibench.bench.store.runs import ResultStore
from calibench.bench.tracking import pack as of
from calibench.bench.tracking.catalogue import find_study
from calibench.bench.tracking.pack import LISTING, unpack
from tests.bench.tracked import study

pytestmark = pytest.mark.usefixtures("one_process", "undrawn", "own_cache")


@pytest.fixture(scope="module")
def sent(tmp_path_factory, one_process, undrawn):
    """Return a folder with the results of a study, noted, and the pack of them."""
    folder = tmp_path_factory.mktemp("sent")
    words = ["run", "problem=sensor_zero", "optimizer=lm", "budget=160", "seeds=2", "study=mine"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in (words, ["note", "mine", "look at this"], ["pack", "mine", "--to", "mine.zip"]):
            with pytest.raises(SystemExit) as ended:
                main(command)
            assert not ended.value.code
            patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    return folder


@pytest.fixture
def packed(tmp_path, run_bench, sent):
    shutil.copytree(sent / "results", tmp_path / "results")
    return Path(shutil.copy(sent / "mine.zip", tmp_path))


def test_a_newcomer_adds_a_method_to_what_was_sent(packed, tmp_path, run_bench):
    code, out, error = run_bench(["unpack", "mine.zip", "results=there"])
    assert (code, error) == (0, "")
    assert "left in it" in out  # its pages
    there = tmp_path / "there" / "mine"
    assert not list(there.rglob("*.html")) + list(there.rglob("*.svg"))
    assert ResultStore(there).finished() == ResultStore(tmp_path / "results" / "mine").finished()
    assert [note.text for note in read_notes(there).notes] == ["look at this"]
    assert "numpy==" in (there / "requirements.txt").read_text()
    assert "bench unpack mine.zip" in (there / "README.md").read_text()
    words = "problem=sensor_zero optimizer=lm,trf budget=160 seeds=2 study=mine results=there"
    code, out, _ = run_bench(["run", "-m", *words.split()])
    assert code == 0
    assert "2 runs (1 done before)" in out


def test_the_pages_come_with_trust(packed, tmp_path, run_bench):
    assert run_bench(["unpack", "mine.zip", "results=there", "--trust"])[0] == 0
    assert (tmp_path / "there" / "mine" / "report.html").exists()


def test_a_pack_of_a_study_that_stands_read_only_leaves_it_alone(tmp_path, run_bench):
    folder = study(tmp_path / "results" / "one")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    folder.chmod(0o555)
    try:
        assert run_bench(["pack", "one", "--to", "one.zip"])[0] == 0
    finally:
        folder.chmod(0o755)
    assert before == {path.name: path.read_bytes() for path in folder.iterdir()}
    assert run_bench(["pack", "one", "--to", "one.zip"])[0] == 2  # it is there already


def test_a_calibration_is_sent_too(tmp_path, run_bench):
    arm = tmp_path / "results" / "calibrate" / "arm7"
    arm.mkdir(parents=True)
    (arm / "six.urdf").write_text("<robot/>")
    (arm / "mine.py").write_text("")
    files = {"urdf": "/home/me/six.urdf"}
    found = {"schema_version": 1, "case": "arm7", "urdf": "six.urdf", "chosen": "zeros", "after": 0.5, "files": files}
    (arm / "calibration.json").write_text(json.dumps(found))
    assert run_bench(["pack", "calibrate/arm7", "--to", "arm.zip"])[0] == 0
    assert run_bench(["unpack", "arm.zip", "results=there"])[0] == 0
    names = {path.name for path in (tmp_path / "there" / "arm7").iterdir()}
    assert names == {"calibration.json", "six.urdf", "README.md", "requirements.txt"}


def made(path, files, listing=None, study="sent", links=(), head=None):
    """Write a pack of these files; `listing` overrides what is stated of them."""
    stated = {name: {"size": len(data), "blake2b": blake2b(data, digest_size=16).hexdigest()} for name, data in files}
    stated |= listing or {}
    text = json.dumps({"kind": of.KIND, "version": 1, "study": study, "what": "runs", "files": stated})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(LISTING, text if head is None else head)
        for name, data in files:
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            if name in links:
                info.external_attr = (stat.S_IFLNK | 0o777) << 16
            archive.writestr(info, data)
    return path


BOMB = b"\0" * 5_000_000
HOSTILE = {
    "above": dict(files=[("../out.csv", b"a")]),
    "absolute": dict(files=[("/tmp/out.csv", b"a")]),
    "drive": dict(files=[("C:out.csv", b"a")]),
    "backslash": dict(files=[("..\\out.csv", b"a")]),
    "inside": dict(files=[("figures/../../out.csv", b"a")]),
    "hidden": dict(files=[(".bashrc.txt", b"a")]),
    "flag": dict(files=[("-rf.csv", b"a")]),
    "reserved": dict(files=[("nul.csv", b"a")]),
    "escape": dict(files=[("a\x1b[2Jb.csv", b"a")]),
    "turned": dict(files=[("a\u202evsc.csv", b"a")]),
    "code": dict(files=[("mine.py", b"raise SystemExit")]),
    "deep": dict(files=[("a/b/c/d/e.csv", b"a")]),
    "capitals": dict(files=[("a.csv", b"a"), ("A.csv", b"b")]),
    "link": dict(files=[("a.csv", b"/etc/passwd")], links=("a.csv",)),
    "folder": dict(files=[("a.csv/", b"")]),
    "unlisted": dict(
        files=[("a.csv", b"a")], head=json.dumps({"kind": of.KIND, "version": 1, "study": "sent", "files": {}})
    ),
    "missing": dict(files=[], listing={"a.csv": {"size": 1, "blake2b": "0"}}),
    "bomb": dict(files=[("a.csv", BOMB)], listing={"a.csv": {"size": 10, "blake2b": "0"}}),
    "short": dict(files=[("a.csv", b"a")], listing={"a.csv": {"size": 10, "blake2b": "0"}}),
    "huge": dict(files=[("a.csv", b"a")], listing={"a.csv": {"size": 10**13, "blake2b": "0"}}),
    "negative": dict(files=[("a.csv", b"a")], listing={"a.csv": {"size": -1, "blake2b": "0"}}),
    "digest": dict(files=[("a.csv", b"a")], listing={"a.csv": {"size": 1, "blake2b": "0" * 32}}),
    "name": dict(files=[("a.csv", b"a")], study="../../out"),
    "here": dict(files=[("a.csv", b"a")], study="."),
    "brackets": dict(files=[("a.csv", b"a")], head="[" * 100_000),
    "long": dict(files=[("a.csv", b"a")], head=" " * 20_000_001),
    "list": dict(files=[("a.csv", b"a")], head="[]"),
    "nothing": dict(files=[("a.csv", b"a")]),
    "manifest": dict(files=[("manifest.json", b"{}"), ("runs.parquet", b"PAR1")]),
    "notes": dict(files=[("notes.json", b"{}"), ("manifest.json", b"{}")]),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_made_to_do_harm_writes_nothing(name, tmp_path, run_bench):
    made(tmp_path / "sent.zip", **HOSTILE[name])
    before = sorted(tmp_path.rglob("*"))
    code, out, error = run_bench(["unpack", "sent.zip", "results=in/there"])
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert len(error) < 500
    assert error.isprintable() or error[:-1].isprintable()
    assert [path for path in sorted(tmp_path.rglob("*")) if path.is_file() and path not in before] == []
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_name_twice_and_what_is_no_pack_are_refused(tmp_path, run_bench):
    with pytest.warns(UserWarning, match="Duplicate"):
        made(tmp_path / "twice.zip", files=[("a.csv", b"a"), ("a.csv", b"b")])
    (tmp_path / "text.zip").write_text("no zip")
    os.mkfifo(tmp_path / "pipe.zip")
    with zipfile.ZipFile(tmp_path / "plain.zip", "w") as archive:
        archive.writestr("a.csv", b"a")
    for name in ("twice", "text", "pipe", "plain", "none"):
        code, _, error = run_bench(["unpack", f"{name}.zip"])
        assert (code, error.count("\n")) == (2, 1)
    assert not (tmp_path / "results").exists()


def test_a_pack_that_was_damaged_on_its_way_is_refused(packed, tmp_path):
    whole = packed.read_bytes()
    for at in (int(len(whole) * share) for share in (0.2, 0.5, 0.9, 0.999)):
        for content in (whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :], whole[:at]):
            packed.write_bytes(content)
            with pytest.raises(ValueError, match=r"^unpack: [^\n]+$"):
                unpack(packed, tmp_path / "there", trust=True)
    assert not list((tmp_path / "there").glob("*")) if (tmp_path / "there").exists() else True


def test_tables_of_a_forger_are_checked_by_their_seals(packed, tmp_path):
    with zipfile.ZipFile(packed) as archive:
        files = [(name, archive.read(name)) for name in archive.namelist() if name != LISTING]
    edited = [(name, data.replace(b"lm", b"de") if name == "runs.parquet" else data) for name, data in files]
    with pytest.raises(ValueError, match=r"runs\.parquet"):
        unpack(made(tmp_path / "forged.zip", edited, study="mine"), tmp_path / "there")
    with pytest.raises(ValueError, match="another study than yours"):
        unpack(made(tmp_path / "renamed.zip", files, study="yours"), tmp_path / "there")
    assert find_study(tmp_path / "results", "mine")[1].done == 1
