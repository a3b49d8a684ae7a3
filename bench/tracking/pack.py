"""A study as one file to send, unpacked without trust; and the end of a study.

A pack is a zip: ``pack.json`` lists each file with its size and digest, beside it are the tables, the page, the
versions that made them (``requirements.txt``) and a README. What is unpacked is checked as it is written: names, kinds,
sizes, digests, and at last the tables by their own seals. A digest guards against damage on the way, not against who
packs: pages, which a browser runs, are unpacked only on `trust`.
"""

import json
import os
import re
import shlex
import shutil
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from hashlib import blake2b, file_digest
from pathlib import Path
from typing import Any, BinaryIO, final

from calibench.bench.exchange.studies import require_free, write_folder
from calibench.bench.execution.in_progress import hosts_at_work
from calibench.bench.report.shared.kept import RECORD
from calibench.bench.report.study.write import write_report
from calibench.bench.store.atomic_file import TEMPORARY, write_whole
from calibench.bench.store.manifest import NOTES, StoreError, read_notes
from calibench.bench.store.runs import HOLDER, LOCK, SOFT_LOCK, ResultStore, locked, merge
from calibench.bench.tracking.catalogue import CALIBRATION, HAND_EYE, MANIFEST, Entry
from calibench.bench.tracking.tables import calibration_in, check_table, rows_in
from calibench.bench.words import check_study
from calibench.core.plain import json_of

KIND, LISTING = "calibench pack", "pack.json"
MOST_FILES, LARGEST, LARGEST_LISTING = 20_000, 4_000_000_000, 20_000_000  # files; bytes in all; bytes of the listing
_DATA = (".json", ".parquet", ".csv", ".md", ".txt", ".urdf", ".yaml", ".xlsx")
_PAGES = (".html", ".svg", ".png")  # what a browser opens
_FOLDERS = ("figures", "tables", "journal", "running", "quarantine", "replay")  # of a study, whatever is in them
_FILES = frozenset(
    (
        MANIFEST, NOTES, CALIBRATION, HAND_EYE, "runs.parquet", "traces.parquet", "hits.parquet", "findings.parquet",
        "gaps.parquet", "readings.parquet", "summary.csv", "overview.csv", "calibrated.csv", "identifiability.csv",
        "report.html", RECORD, "report.json", "static_transforms.yaml", "requirements.txt", "README.md", LOCK,
        SOFT_LOCK, HOLDER,
    )
)  # fmt: skip
_NOT_SENT = frozenset((LOCK, SOFT_LOCK, HOLDER, RECORD))
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)
_NO_PACK = (
    zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, NotImplementedError, EOFError, RuntimeError, UnicodeError,
)  # fmt: skip
_AT_ONCE = 1 << 20
_README = """A study of calibench: {study}

{what}
To go on from it, with calibench installed (the last command makes the page, report.html):

    bench unpack {file}
    bench studies
    bench report results/{study}

Add a method by the command that made it, with -m and one name more (optimizer=de,lm); finished runs are kept:

    {command}

requirements.txt has the versions that made these rows. pack.json has a digest of each file.
"""


def files_of_ours(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the files in a study's folder that bench wrote, and what else stands there; links are never ours."""
    named = _FILES
    if (folder / CALIBRATION).is_file():  # it lists files: its URDF is called as the user's own
        found = json_of((folder / CALIBRATION).read_bytes())
        files = found.get("files") if isinstance(found, dict) else None
        paths = files.values() if isinstance(files, dict) else ()
        named = named | {Path(path).name for path in paths if isinstance(path, str)}
    mine: list[Path] = []
    others: list[Path] = []
    waiting = [(folder, named, False)]
    while waiting:
        here, names, whole = waiting.pop()
        for path in sorted(here.iterdir()):
            mode = os.lstat(path).st_mode
            if stat.S_ISDIR(mode):
                is_case = here == folder and os.path.lexists(path / "report.json")
                if whole or path.name in _FOLDERS:
                    waiting.append((path, names, True))
                elif is_case:
                    waiting.append((path, _FILES, False))
                else:
                    others.append(path)
            elif stat.S_ISREG(mode) and (whole or path.name in names or TEMPORARY.search(path.name)):
                mine.append(path)
            else:
                others.append(path)
    return sorted(mine), others


def pack(folder: Path, entry: Entry, to: Path) -> tuple[Path, str]:
    """Write a study as one file; return its path and the digest of its content. The study stays as it is."""
    if os.path.lexists(to):
        raise ValueError(f"pack: --to {to}: is there already; name a new file")
    name = folder.resolve().name
    with tempfile.TemporaryDirectory(prefix="bench-pack-") as scratch:
        copy = Path(scratch) / name
        if entry.kind == "runs":
            merge([folder], copy)  # collected, with notes and the plan
            if entry.done:
                write_report(ResultStore(copy))
        else:
            for path in files_of_ours(folder)[0]:
                (copy / path.relative_to(folder)).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, copy / path.relative_to(folder))
        # the packages that made the newest row, pinned
        table = {"runs": "runs", "discovery": "gaps"}.get(entry.kind)
        rows = rows_in(copy, table, ("versions", "started_at")).to_pylist() if table else []  # type: ignore[arg-type]
        known = [row for row in rows if row["versions"] and row["started_at"]]
        needed = "calibench\n"
        if known:
            versions = json_of(max(known, key=lambda row: row["started_at"])["versions"])
            lines = [f"# Python {versions.pop('python', '')}; calibench of commit {entry.commit or 'not known'}"]
            lines += [f"{package}=={version}" for package, version in versions.items() if version]
            needed = "\n".join([*lines, ""])
        (copy / "requirements.txt").write_text(needed, encoding="utf-8")
        again = {"study": shlex.quote(name), "file": shlex.quote(to.name)}
        what, command = f"{entry.kind}: {entry.headline}\n", entry.command or "bench run ..."
        (copy / "README.md").write_text(_README.format(**again, what=what, command=command), "utf-8")
        mine, _ = files_of_ours(copy)
        files = [path for path in mine if path.name not in _NOT_SENT and not TEMPORARY.search(path.name)]
        listing = {}
        for path in files:
            with open(path, "rb") as source:
                digest = file_digest(source, partial(blake2b, digest_size=16)).hexdigest()
            listing[path.relative_to(copy).as_posix()] = {"size": path.stat().st_size, "blake2b": digest}
        text = json.dumps({"kind": KIND, "version": 1, "study": name, "what": entry.kind, "files": listing}, indent=1)

        def write(file: BinaryIO) -> None:
            with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr(zipfile.ZipInfo(LISTING), text)
                for path in files:
                    info = zipfile.ZipInfo(path.relative_to(copy).as_posix())
                    info.compress_type = zipfile.ZIP_DEFLATED
                    with open(path, "rb") as source, archive.open(info, "w") as target:
                        shutil.copyfileobj(source, target, _AT_ONCE)

        return write_whole(to, write), blake2b(text.encode(), digest_size=16).hexdigest()


@final
@dataclass(frozen=True)
class Unpacked:
    """Where a pack was unpacked, the digest of its content, how many files, and how many pages were left in it."""

    folder: Path
    digest: str
    files: int
    left: int


def unpack(archive: Path, results: Path, trust: bool = False) -> Unpacked:
    """Unpack a study below `results`, whole or not at all. Raises `ValueError`, in one line, for anything amiss."""
    mode = os.stat(archive).st_mode
    if not stat.S_ISREG(mode):
        raise ValueError(f"unpack: {archive}: is no regular file")
    try:
        with zipfile.ZipFile(archive) as opened:
            return _unpack(opened, results, trust)
    except _NO_PACK as error:
        raise ValueError(f"unpack: {archive}: is no whole pack: {error}") from None
    except (StoreError, _Refused) as error:
        raise ValueError(f"unpack: {archive}: {error}") from None


class _Refused(ValueError):
    """Why a pack is not unpacked."""


def _unpack(archive: zipfile.ZipFile, results: Path, trust: bool) -> Unpacked:
    members = archive.infolist()
    if len(members) > MOST_FILES:
        raise _Refused(f"holds {len(members)} files, and at most {MOST_FILES} are unpacked")
    by_name = {member.filename: member for member in members}
    if len(by_name) < len(members):
        raise _Refused("holds a name twice")
    text, study, listing = _listing(archive, by_name)
    _check_names(listing, by_name)
    target = results / study
    if os.path.lexists(target):
        raise _Refused(f"{target} is there already; give another results=DIR, and `bench merge` joins both")
    wanted = {name: one for name, one in listing.items() if trust or not name.lower().endswith(_PAGES)}

    def fill(folder: Path) -> None:
        for name, (size, digest) in wanted.items():
            path, member, mine, left = folder / name, by_name[name], blake2b(digest_size=16), size
            path.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(member) as source, open(path, "xb") as target:
                while part := source.read(min(_AT_ONCE, left + 1)):
                    left -= len(part)
                    if left < 0:
                        raise _Refused(f"{member.filename!a:.100}: holds more than the {size} bytes that are stated")
                    mine.update(part)
                    target.write(part)
            if left or mine.hexdigest() != digest:
                raise _Refused(f"{member.filename!a:.100}: was damaged: its digest is another")
        # what was unpacked has to be a study that can be read
        read_notes(folder)
        others = (CALIBRATION, HAND_EYE, "gaps.parquet")
        if (folder / "runs.parquet").exists() or not any((folder / name).exists() for name in others):
            store = ResultStore(folder)
            if store.manifest()["study"] != study:
                raise _Refused(f"its manifest is of another study than {study}")
            for name in ("runs", "traces"):
                if (folder / f"{name}.parquet").exists():
                    check_table(folder / f"{name}.parquet", sealed=True)
            store.tables()
        elif (folder / "gaps.parquet").exists():
            for name in ("gaps", "findings"):
                check_table(folder / f"{name}.parquet", sealed=False)
        elif calibration_in(folder) is None:
            raise _Refused("holds no study, discovery or calibration")

    require_free(target)
    write_folder(target, fill)
    digest_of_all = blake2b(text, digest_size=16).hexdigest()
    return Unpacked(target, digest_of_all, len(wanted), len(listing) - len(wanted))


def _listing(
    archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo]
) -> tuple[bytes, str, dict[str, tuple[int, str]]]:
    """Return the listing: its text, the study's name, and of each file its size and digest."""
    member = members.get(LISTING)
    if member is None:
        raise _Refused("has no pack.json, so `bench pack` has not written it")
    _check_member(member)
    with archive.open(member) as file:
        text = file.read(LARGEST_LISTING + 1)
    if len(text) > LARGEST_LISTING:
        raise _Refused(f"its pack.json has more than {LARGEST_LISTING // 1_000_000} MB")
    try:
        found: Any = json_of(text)
        if found["kind"] != KIND or found["version"] != 1:
            raise KeyError
        study = found["study"]
        listing = {name: (one["size"], one["blake2b"]) for name, one in found["files"].items()}
        whole = all(type(n) is int and n >= 0 and isinstance(digest, str) for n, digest in listing.values())
        if not isinstance(study, str) or not whole:
            raise TypeError
    except (ValueError, KeyError, TypeError, AttributeError):
        raise _Refused("its pack.json is damaged, or of another version") from None
    check_study(study)
    _check_part(study, study)
    if (total := sum(size for size, _ in listing.values())) > LARGEST:
        raise _Refused(f"states {total // 1_000_000} MB, and at most {LARGEST // 1_000_000} MB are unpacked")
    return text, study, listing


def _check_names(listing: Iterable[str], members: dict[str, zipfile.ZipInfo]) -> None:
    """Raise where a name leads out of the folder, is no file of a study, is no plain file, or is told nowhere."""
    names = list(listing)
    for name in names:
        parts = name.split("/")
        if len(parts) > 4:
            raise _Refused(f"{name!a:.100}: stands too deep")
        for part in parts:
            _check_part(part, name)
        if not name.lower().endswith((*_DATA, *_PAGES)):
            raise _Refused(f"{name!a:.100}: is no file of a study")
    if len({name.casefold() for name in names}) < len(names):
        raise _Refused("holds two names that differ in capitals alone")
    if odd := {*names, LISTING} ^ members.keys():
        raise _Refused(f"{min(odd)!a:.100}: is in the file or in its pack.json, and not in both")
    for member in members.values():
        _check_member(member)


def _check_part(part: str, name: str) -> None:
    bad = not part or part.startswith((" ", "-", ".")) or part.endswith((".", " ")) or _RESERVED.match(part)
    if bad or not part.isprintable() or any(c in '\\:*?"<>|/' for c in part) or len(part.encode()) > 200:
        raise _Refused(f"{name!a:.100}: is no name for a file in a folder of its own")


def _check_member(member: zipfile.ZipInfo) -> None:
    kind = stat.S_IFMT(member.external_attr >> 16)
    if kind not in (0, stat.S_IFREG) or member.is_dir():
        raise _Refused(f"{member.filename!a:.100}: is a link or no plain file")
    if member.flag_bits & 1:
        raise _Refused(f"{member.filename!a:.100}: is encrypted")
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise _Refused(f"{member.filename!a:.100}: is packed in a way that `bench pack` does not use")


def delete(folder: Path) -> tuple[int, list[Path]]:
    """Delete what is ours in a study's folder, and the folder where nothing else is in it; return how many files, and
    what was left. Raises `ValueError` while somebody is at work there.
    """
    if hosts := hosts_at_work(folder):
        raise ValueError(f"delete: {folder}: {', '.join(sorted(hosts))} is at work on it; stop that first")
    with locked(folder, at_most=2.0):
        mine, others = files_of_ours(folder)
        for path in [path for path in mine if path.name not in _NOT_SENT]:
            path.unlink()
    for name in _NOT_SENT:
        (folder / name).unlink(missing_ok=True)
    for here, _, _ in os.walk(folder, topdown=False):  # the deepest first; no link is followed
        with suppress(OSError):  # something that is not ours stands in it
            os.rmdir(here)
    return len(mine), others
