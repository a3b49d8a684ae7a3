"""The lock of a study: one process at a time, whatever the file system, and a wait says who is to be asked."""

import errno
import logging
import subprocess
import sys
from pathlib import Path

import filelock
import pytest

from calibench.bench.store.runs import LockHeldError, ResultStore, locked

ROOT = Path(__file__).resolve().parents[2]
HOLD = """
import sys
from pathlib import Path
from calibench.bench.store.runs import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.readline()
"""
COUNT = """
import sys
from pathlib import Path
from calibench.bench.store.runs import locked
folder = Path(sys.argv[1])
for _ in range(50):
    with locked(folder):
        count = folder / "count"
        count.write_text(str(int(count.read_text()) + 1))
"""
# a file system without locks: what it answers to whoever asks for one
WITHOUT = f"""
import errno, filelock
def refuse(self, *args, **options):
    raise OSError(errno.ENOLCK, "No locks available")
filelock.FileLock.acquire = refuse
{COUNT}
"""


def process(code, folder):
    return subprocess.Popen(
        [sys.executable, "-c", code, str(folder)], cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the lock of `tmp_path` until it reads a line."""
    with process(HOLD, tmp_path) as other:
        assert other.stdout.readline() == "held\n"
        yield other
        other.communicate("\n")


def test_a_held_lock_names_its_file_and_who_to_ask(tmp_path, holder, caplog):
    with caplog.at_level(logging.WARNING), pytest.raises(LockHeldError) as told, locked(tmp_path, 0.05, 0.1):
        pytest.fail("two processes hold one lock")
    assert str(tmp_path / ".lock") in str(told.value)
    assert f"process {holder.pid} of " in str(told.value)
    assert "\n" not in str(told.value)
    assert [record.message for record in caplog.records] == [
        f"{tmp_path / '.lock'}: is held by {str(told.value).split('held by ')[1].split(' for 0.1')[0]}; waiting"
    ]


def test_a_lock_is_free_when_its_process_has_been_killed(tmp_path, holder):
    holder.kill()
    holder.wait()
    with locked(tmp_path, 5.0, 5.0):
        assert (tmp_path / ".lock.holder").exists()
    assert not (tmp_path / ".lock.holder").exists()


@pytest.mark.parametrize("code", [COUNT, WITHOUT], ids=["with the system's locks", "without"])
def test_two_processes_lose_no_count(tmp_path, code):
    (tmp_path / "count").write_text("0")
    both = [process(code, tmp_path) for _ in range(2)]
    assert [other.communicate() and other.returncode for other in both] == [0, 0]
    assert (tmp_path / "count").read_text() == "100"


def test_an_error_that_is_no_lack_of_locks_is_raised(tmp_path, monkeypatch):
    def refuse(self, *args, **options):
        raise OSError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(filelock.FileLock, "acquire", refuse)
    with pytest.raises(PermissionError), locked(tmp_path):
        pass


def test_what_a_kill_while_the_lock_was_held_leaves_is_no_strangers_folder(tmp_path):
    for name in (".lock", ".lock.soft", ".lock.holder"):
        (tmp_path / name).touch()
    store = ResultStore(tmp_path)
    (tmp_path / ".lock.soft").unlink()
    store.open()
    assert store.manifest()["planned"] == {}
