"""What is kept between processes is that of the same bytes, and nothing depends on its being there."""

import pytest

from calibench.core import sources
from calibench.core.kept import cache_root, kept


@pytest.fixture(autouse=True)
def root(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "calibench" / "kind"


def made(calls, value):
    def make():
        calls.append(value)
        return value

    return make


def test_the_same_bytes_are_worked_out_once():
    calls = []
    assert [kept("kind", (b"a", b"b"), made(calls, [1, None])) for _ in range(2)] == [[1, None]] * 2
    assert calls == [[1, None]]


def test_other_bytes_are_worked_out_anew_however_they_are_cut():
    calls = []
    for of in ((b"ab", b"c"), (b"a", b"bc"), (b"abc",)):
        kept("kind", of, made(calls, len(calls)))
    assert calls == [0, 1, 2]


def test_what_was_spoilt_is_worked_out_anew(root):
    kept("kind", (b"a",), lambda: 1)
    (path,) = root.iterdir()
    path.write_bytes(b"[1, ")
    assert kept("kind", (b"a",), lambda: 2) == 2
    assert kept("kind", (b"a",), lambda: 3) == 2


def test_a_folder_that_cannot_be_written_is_no_hindrance(tmp_path):
    (tmp_path / "calibench").write_text("a file where the folder should be")
    assert [kept("kind", (b"a",), lambda value=value: value) for value in (1, 2)] == [1, 2]


def test_a_digest_does_not_depend_on_what_was_kept(monkeypatch):
    def digest():
        monkeypatch.setattr(sources, "_SEEN", {})
        monkeypatch.setattr(sources, "_DIGESTS", {})
        return sources.module_digest("calibench.core.sources")

    first = digest()
    assert len(list((cache_root() / "sources").glob("*.json"))) == 2
    assert digest() == first
