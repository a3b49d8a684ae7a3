"""Some 1000 damaged data files through every door that reads one: what is refused, and what is taken with which words.

    python -m benchmarks.damaged [--to FOLDER] [--only WORD]

Sound files are made from the demonstrations that ship, and by a simulation here; each is damaged in every way that its
kind bears, with the seed that its name ends in. Each command runs in a process of its own, forked after the imports,
with the limits of `forked.py`. Told are tracebacks, exit codes other than 0, 1 and 2, commands above 20 s or 1 GB, refusals
of more than one line or above 2 s of CPU, and all that was taken, with the words that were printed. Exit code 1 where
something is wrong.
"""

# ruff: noqa: E501 (a file a line)

from __future__ import annotations

import argparse
import csv
import gzip
import io
import json
import os
import random
import re
import shutil
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import forked

DEMO = Path(__file__).resolve().parents[1] / "discrepancy" / "demo"
AT_ONCE = 2.0  # CPU s of a refusal
Rows = list[list[str]]
Random = random.Random


@dataclass(frozen=True)
class Door:
    """A way in: the words of a command with {} for the damaged file, whose sound content is `sound`."""

    name: str
    words: str
    ending: str
    sound: bytes
    rows: Rows | None = None  # of a table


@dataclass(frozen=True)
class Case:
    """A command, and the damaged file that it reads: one that was written before, or what is no such file."""

    name: str
    words: list[str]
    written: Path
    special: Callable[[Path], None] | None
    ending: str


@dataclass(frozen=True)
class Outcome:
    """How a command ended, and what is wrong with that."""

    name: str
    ended: forked.Ended

    @property
    def wrong(self) -> str:
        """Return what is wrong, "" where nothing is."""
        late = self.ended.code == 2 and self.ended.cpu > AT_ONCE
        return ", ".join([*self.ended.faults(), *["late refusal"] * late])


# ---- sound files


def table_text(rows: Rows) -> bytes:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue().encode("utf-8", "surrogatepass")


def demo_rows(name: str, most: int) -> Rows:
    lines = (DEMO / name).read_text(encoding="utf-8").splitlines()
    return list(csv.reader(line for line in lines if not line.startswith("#")))[: most + 1]


def pose(place: Any, vector: Any) -> Any:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), place
    return made


def hand_eye_rows() -> Rows:
    rng = np.random.default_rng(11)
    camera, board = pose([40, -25, 110], [0.3, -0.5, 0.8]), pose([620, 150, -80], [2.6, 0.4, -0.7])
    turns = ("qx", "qy", "qz", "qw")
    rows = [[f"{of}_{one}" for of in ("flange", "board") for one in ("x [mm]", "y [mm]", "z [mm]", *turns)]]
    for _ in range(15):
        flange = pose([500, 100, 450], [2.9, 0.3, 0.1]) @ pose(rng.uniform(-150, 150, 3), rng.normal(0, 0.6, 3))
        seen = np.linalg.inv(camera) @ np.linalg.inv(flange) @ board @ pose(rng.normal(0, 0.05, 3), [1e-5, 1e-5, 0])
        rows.append(
            [f"{v:.9g}" for one in (flange, seen) for v in (*one[:3, 3], *Rotation.from_matrix(one[:3, :3]).as_quat())]
        )
    return rows


DH_ROWS = [
    ["joint", "a [m]", "alpha [rad]", "d [m]", "theta [rad]"],
    ["axis_1", "0", "pi/2", "0.1273", "0"], ["axis_2", "-0.612", "0", "0", "0"], ["axis_3", "-0.5723", "0", "0", "0"],
    ["axis_4", "0", "pi/2", "0.1639", "0"], ["axis_5", "0", "-pi/2", "0.1157", "0"], ["axis_6", "0", "0", "0.0922", "0"],
]  # fmt: skip


def dh_readings() -> bytes:
    rng, rows = np.random.default_rng(12), []
    for q in rng.uniform(-2, 2, (40, 6)):
        at = np.eye(4)
        for (_, a, alpha, d, _), angle in zip(DH_ROWS[1:], q, strict=True):
            al = {"pi/2": np.pi / 2, "-pi/2": -np.pi / 2, "0": 0.0}[alpha]
            c, s, ca, sa = np.cos(angle + 1e-3), np.sin(angle + 1e-3), np.cos(al), np.sin(al)
            a_, d_ = float(a), float(d)
            at = at @ np.array(
                [[c, -s * ca, s * sa, a_ * c], [s, c * ca, -c * sa, a_ * s], [0, sa, ca, d_], [0, 0, 0, 1]]
            )
        rows.append([f"{v:.9f}" for v in (*q, *(at[:3, 3] + rng.normal(0, 3e-5, 3)))])
    return table_text([[*(f"axis_{k} [rad]" for k in range(1, 7)), "x [m]", "y [m]", "z [m]"], *rows])


def orthoglide_rows() -> Rows:
    from calibench.problems.orthoglide.plans import measured

    names = ["leg", "direction", "posture", "gauge_position", "level_mm", "against_mm", "pass", "payload_N", "repeat"]
    rows = [
        [
            r.leg,
            r.direction,
            r.axis,
            r.gauge_position,
            r.level_mm,
            r.against_mm,
            r.approach,
            r.payload_N,
            r.repeat,
            value,
        ]
        for r, value in zip(*measured("exp2"), strict=True)
    ]
    return [[*names, "deviation [mm]"], *([str(cell) for cell in row] for row in rows)]


def as_parquet(rows: Rows, metadata: str = '{"machine": "gpm2002", "sigma_enc": 5.5e-5}') -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = _columns(rows)
    heads = [name.partition(" [") for name in columns]
    fields = [
        pa.field(name, pa.array(column).type, metadata={"unit": unit.rstrip("]")} if bracket else None)
        for (name, bracket, unit), column in zip(heads, columns.values(), strict=True)
    ]
    out = io.BytesIO()
    schema = pa.schema(fields, metadata={"measured_data": metadata})
    pq.write_table(pa.table([pa.array(column) for column in columns.values()], schema=schema), out, compression="zstd")
    return out.getvalue()


def as_excel(rows: Rows) -> bytes:
    import openpyxl

    book = openpyxl.Workbook()
    for row in rows:
        book.active.append([_cell(cell) for cell in row])
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def as_matlab(rows: Rows) -> bytes:
    from scipy.io import savemat

    out = io.BytesIO()
    names = {re.sub(r"\W", "_", name.partition(" [")[0]): column for name, column in _columns(rows).items()}
    savemat(out, {name: np.array(column) for name, column in names.items()}, do_compression=True)
    return out.getvalue()


def _columns(rows: Rows) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for k, name in enumerate(rows[0] if rows else []):
        cells = [_cell(row[k]) if k < len(row) else None for row in rows[1:]]
        words = any(isinstance(cell, str) for cell in cells)
        found[name] = [str(cell) for cell in cells] if words else [float("nan") if c is None else c for c in cells]
    return found


def _cell(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


# ---- damages, each with its own seed


def _cut(part: float) -> Callable[[bytes, Random], bytes]:
    return lambda b, r: b[: int(len(b) * part)]


def _flip(count: int) -> Callable[[bytes, Random], bytes]:
    def flip(b: bytes, r: Random) -> bytes:
        damaged = bytearray(b)
        for _ in range(count):
            damaged[r.randrange(len(b))] ^= 1 << r.randrange(8)
        return bytes(damaged)

    return flip


def _block(change: Callable[[bytes], bytes]) -> Callable[[bytes, Random], bytes]:
    def apply(b: bytes, r: Random) -> bytes:
        at, size = r.randrange(len(b)), max(4, len(b) // 20)
        return b[:at] + change(b[at : at + size]) + b[at + size :]

    return apply


BYTES: dict[str, Callable[[bytes, Random], bytes]] = {
    "empty": lambda b, r: b"",
    **{f"cut_at_{part:g}": _cut(part) for part in (0.02, 0.4, 0.9, 0.999)},
    **{f"flip_{count}_{i}": _flip(count) for count in (1, 20) for i in range(2)},
    "flip_300": _flip(300),
    "zeros_inside": _block(lambda part: bytes(len(part))),
    "part_twice": _block(lambda part: part + part),
    "part_lost": _block(lambda part: b""),
    "tail": lambda b, r: b + bytes(r.randrange(256) for _ in range(3000)),
}
TEXTS: dict[str, Callable[[bytes, Random], bytes]] = {
    "utf16": lambda b, r: b.decode().encode("utf-16"),
    "utf16_without_mark": lambda b, r: b.decode().encode("utf-16-le"),
    "mark": lambda b, r: b"\xef\xbb\xbf" + b,
    "old_mac": lambda b, r: b.replace(b"\n", b"\r"),
    "two_encodings": lambda b, r: b[:40] + b"\xc3\xa9 \xe9\x81" + b[40:],
    **{
        f"number_{word[:6]}_{i}": lambda b, r, word=word: _number(b, r, word)
        for word in ("nan", "-1e308", "9" * 400, "one", "", "-7", "１２", "1,5")
        for i in range(2)
    },
}


def _number(b: bytes, r: Random, word: str) -> bytes:
    places = [found.span() for found in re.finditer(rb"(?<![\w.])-?\d+\.?\d*", b)]
    start, end = r.choice(places)
    return b[:start] + word.encode() + b[end:]


def _column(change: Callable[[list[str], Random], list[str] | None]) -> Callable[[Rows, Random], Rows]:
    """Return the damage of one column, drawn: its head and its cells become others, or it is lost."""

    def apply(rows: Rows, r: Random) -> Rows:
        columns = [list(column) for column in zip(*rows, strict=True)]
        k = r.randrange(len(columns))
        changed = change(columns[k], r)
        columns[k : k + 1] = [] if changed is None else [changed]
        return [list(row) for row in zip(*columns, strict=True)]

    return apply


def _cells(change: Callable[[str], str]) -> Callable[[Rows, Random], Rows]:
    return _column(lambda column, r: [column[0], *map(change, column[1:])])


def _head(change: Callable[[str], str]) -> Callable[[Rows, Random], Rows]:
    return _column(lambda column, r: [change(column[0]), *column[1:]])


def _some_cells(word: str, count: int = 1) -> Callable[[Rows, Random], Rows]:
    def change(rows: Rows, r: Random) -> Rows:
        for _ in range(count):
            row = r.choice(rows[1:])
            row[r.randrange(len(row))] = word
        return rows

    return change


def _exchange(rows: Rows, r: Random) -> Rows:
    a, b = r.sample(range(len(rows[0])), 2)
    for row in rows[1:]:
        row[a], row[b] = row[b], row[a]
    return rows


def _wide(rows: Rows, r: Random) -> Rows:
    return [[*row, *(f"c{k}" if i == 0 else "0" for k in range(100_000))] for i, row in enumerate(rows[:3])]


def _times(factor: float) -> Callable[[str], str]:
    return lambda cell: repr(float(cell) * factor) if isinstance(_cell(cell), float) else cell


TABLES: dict[str, Callable[[Rows, Random], Rows]] = {
    **{f"cell_{word[:5]}": _some_cells(word) for word in ("NaN", "inf", "1e308", "9" * 400, "-5", "text", "", "1;2")},
    "cells_1e308": _some_cells("1e308", 30),
    "cells_NaN": _some_cells("NaN", 60),
    **{f"exchanged_{i}": _exchange for i in range(2)},
    **{f"column_lost_{i}": _column(lambda column, r: None) for i in range(3)},
    "column_NaN": _cells(lambda cell: "NaN"),
    "column_same": _cells(lambda cell: "1"),
    "column_text": _cells(lambda cell: f"no {cell}"),
    "column_large": _cells(_times(1e300)),
    "column_times_1000": _cells(_times(1000)),
    "column_negative": _cells(_times(-1)),
    "head_twice": lambda rows, r: [[*rows[0][:-1], rows[0][0]], *rows[1:]],
    "head_unit": _head(lambda head: head.partition(" [")[0] + " [furlong]"),
    "head_unit_wrong": _head(lambda head: head.partition(" [")[0] + " [deg]"),
    "head_unicode": _head(lambda head: head[:1] + "\u200b\u202e" + head[1:]),
    "head_long": _head(lambda head: head * 3000),
    "head_again": lambda rows, r: [*rows[:9], rows[0], *rows[9:]],
    "no_head": lambda rows, r: rows[1:],
    "only_head": lambda rows, r: rows[:1],
    "one_row": lambda rows, r: rows[:2],
    "three_rows": lambda rows, r: rows[:4],
    "rows_same": lambda rows, r: [rows[0], *[list(rows[1])] * (len(rows) - 1)],
    "rows_twice": lambda rows, r: [*rows, *rows[1:]],
    "ragged": lambda rows, r: [row if i % 3 else row[:2] for i, row in enumerate(rows)],
    "wide": _wide,
}


# ---- files of one kind


def joint(name: str, parent: str, child: str, inside: str = "", kind: str = "revolute") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="1"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{limit}{inside}</joint>\n'


def mimic(of: str) -> str:
    return f'<mimic joint="{of}" multiplier="1" offset="0"/>'


def robot(inside: str, head: str = "") -> str:
    return f'<?xml version="1.0"?>\n{head}<robot name="r">\n{inside}</robot>\n'


def many(count: int, parent: Callable[[int], int]) -> str:
    links = "".join(f'<link name="l{k}"/>' for k in range(count))
    return robot(links + "".join(joint(f"j{k}", f"l{parent(k)}", f"l{k}") for k in range(1, count)))


def urdfs(sound: str) -> dict[str, str]:
    """Return damaged URDFs by name."""
    names = re.findall(r'<joint name="(\w+)" type="revolute"', sound)
    first, second, third = names[:3]

    def inside(name: str, more: str, text: str = sound) -> str:
        return re.sub(rf'(<joint name="{name}"[^>]*>)', lambda found: found[1] + more, text, count=1)

    def once(old: str, new: str) -> str:
        assert re.search(old, sound), old
        return re.sub(old, new, sound, count=1)

    laughs = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10 if k else "ha" * 10}">' for k in range(10))
    return {
        "mimic_itself": inside(first, mimic(first)),
        "mimic_circle": inside(first, mimic(second), inside(second, mimic(first))),
        "mimic_circle_of_3": inside(first, mimic(second), inside(second, mimic(third), inside(third, mimic(first)))),
        "mimic_of_mimic": inside(second, mimic(first), inside(third, mimic(second))),
        "mimic_nobody": inside(second, mimic("nobody")),
        "mimic_huge": inside(second, f'<mimic joint="{first}" multiplier="1e308"/>'),
        "mimic_zero": inside(second, f'<mimic joint="{first}" multiplier="0"/>'),
        "chain_1e5": many(100_000, lambda k: k - 1),
        "star_1e5": many(100_000, lambda k: 0),
        "comb_2e4": many(20_000, lambda k: k - 1 if k % 2 else max(k - 2, 0)),
        "chain_1500": many(1_500, lambda k: k - 1),
        "chain_300": many(300, lambda k: k - 1),
        "laughs": robot("&e9;", f"<!DOCTYPE robot [{laughs}]>") + "",
        "laughs_in_a_name": robot('<link name="&e9;"/>', f"<!DOCTYPE robot [{laughs}]>"),
        "external": robot("&x;", '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///dev/zero">]>'),
        "deep_xml": robot("<a>" * 300_000 + "</a>" * 300_000),
        "huge_attribute": once("<robot name=\"[^\"]*\"", f'<robot name="{"n" * 3_000_000}"'),
        "huge_name": sound.replace(f'"{first}"', f'"{"n" * 2_000_000}"'),
        "many_attributes": once("<robot ", "<robot " + " ".join(f'a{k}="1"' for k in range(100_000)) + " "),
        "twice": sound.replace("</robot>", "") + sound[sound.index("<robot") :],
        "joint_twice": sound.replace(f'"{second}"', f'"{first}"'),
        "cycle": robot('<link name="a"/><link name="b"/>' + joint("p", "a", "b") + joint("q", "b", "a")),
        "own_parent": robot('<link name="a"/><link name="b"/>' + joint("p", "a", "a") + joint("q", "a", "b")),
        "no_links": re.sub(r"<link name=\"\w+\"/>", "", sound),
        "no_axis": re.sub(r"<axis [^>]*>", "", sound),
        "axis_zero": re.sub(r"<axis xyz=\"[^\"]*\"", '<axis xyz="0 0 0"', sound, count=1),
        "axis_tiny": re.sub(r"<axis xyz=\"[^\"]*\"", '<axis xyz="0 0 1e-320"', sound, count=1),
        "axis_huge": re.sub(r"<axis xyz=\"[^\"]*\"", '<axis xyz="1e308 1e308 1e308"', sound, count=1),
        "xyz_nan": once(r"xyz=\"[^\"]*\"", 'xyz="nan 0 0"'),
        "xyz_huge": once(r"xyz=\"[^\"]*\"", 'xyz="1e308 0 0"'),
        "xyz_two": once(r"xyz=\"[^\"]*\"", 'xyz="1 2"'),
        "xyz_million": once(r"xyz=\"[^\"]*\"", f'xyz="{"1 " * 1_000_000}"'),
        "in_mm": re.sub(r'(origin\s+xyz=")([^"]*)"', lambda m: m[1] + " ".join(str(1000 * float(v)) for v in m[2].split()) + '"', sound),
        "all_zero": re.sub(r"xyz=\"[^\"]*\"(?=[^>]*rpy)", 'xyz="0 0 0"', sound),
        "all_prismatic": sound.replace("revolute", "prismatic"),
        "all_fixed": sound.replace("revolute", "fixed"),
        "floating": once("revolute", "floating"),
        "kind_unknown": once("revolute", "wobbly"),
        "xacro": once("<robot ", '<robot xmlns:xacro="x" ').replace("</robot>", "<xacro:arm/></robot>"),
        "other_root": sound.replace("robot", "sdf"),
        "latin1": ('<?xml version="1.0" encoding="latin-1"?>' + sound).replace("</robot>", "<!-- é --></robot>"),
        "encoding_unknown": '<?xml version="1.0" encoding="klingon"?>' + sound.partition("?>")[2],
        "html": "<html><body>404 Not Found</body></html>",
        "json": '{"robot": []}',
        "name_script": sound.replace(f'"{first}"', '"&lt;script&gt;alert(1)&lt;/script&gt;"'),
        "name_path": sound.replace(f'"{first}"', '"../../etc/passwd"'),
        "name_newline": sound.replace(f'"{first}"', '"a&#10;b"'),
        "limit_inverted": once(r"lower=\"[^\"]*\" upper=\"[^\"]*\"", 'lower="1" upper="-1"'),
        "limit_narrow": re.sub(r"lower=\"[^\"]*\" upper=\"[^\"]*\"", 'lower="-.01" upper=".01"', sound),
        "limit_nan": once(r"lower=\"[^\"]*\"", 'lower="nan"'),
    }  # fmt: skip


def matlab_header() -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def matrix(name: str, shape: Sequence[int], inside: bytes, of: int = 6) -> bytes:
    """Return an array of class `of` (1 cell, 2 struct, 6 double); what is `inside` need not fit its shape."""
    head = element(6, struct.pack("<II", of, 0)) + element(5, struct.pack(f"<{len(shape)}i", *shape))
    return element(14, head + element(1, name.encode()) + inside)


def packed(content: bytes) -> bytes:
    squeezed = zlib.compress(content, 9)
    return struct.pack("<II", 15, len(squeezed)) + squeezed


def bomb_of_zeros(size: int, head: bytes = b"") -> bytes:
    """Return packed zeros behind `head`, without holding them."""
    squeeze = zlib.compressobj(9)
    parts = [squeeze.compress(head)] + [squeeze.compress(bytes(1 << 20)) for _ in range(size >> 20)]
    return b"".join([*parts, squeeze.flush()])


def matlabs(sound: bytes) -> dict[str, bytes]:
    """Return `.mat` files that say something else than they hold."""
    head = matlab_header()

    def zeros(shape: Sequence[int], size: int, name: str = "enc_1", of: int = 6) -> bytes:
        inside = element(6, struct.pack("<II", of, 0)) + element(5, struct.pack(f"<{len(shape)}i", *shape))
        inside += element(1, name.encode()) + struct.pack("<II", 9, size)
        squeezed = bomb_of_zeros(size, struct.pack("<II", 14, min(len(inside) + size, 2**32 - 1)) + inside)
        return head + struct.pack("<II", 15, len(squeezed)) + squeezed

    deep, wide = b"", 20_000
    for _ in range(wide):
        deep = matrix("", (1, 1), deep, of=1)
    fields = element(5, struct.pack("<i", 8)) + element(1, b"a".ljust(8, b"\0"))
    return {
        "zeros_2_GB": zeros((250_000_000, 1), 2_000_000_000),
        "zeros_300_MB": zeros((37_500_000, 1), 300_000_000),
        "zeros_not_declared": zeros((10, 1), 2_000_000_000),
        "struct_of_zeros": head
        + packed(matrix("s", (1, 1), fields + matrix("", (100_000_000, 1), element(9, bytes(800_000_000))), of=2)),
        "cell_of_billions": head + matrix("c", (2_000_000_000, 1), b"", of=1),
        "struct_of_billions": head + matrix("s", (1, 1), fields + matrix("", (2_000_000_000, 1), b"", of=1), of=2),
        "negative_shape": head + matrix("enc_1", (-5, 1), element(9, bytes(40))),
        "shape_not_held": head + matrix("enc_1", (50, 50), element(9, bytes(40))),
        "many_dimensions": head + matrix("enc_1", [1] * 500, element(9, bytes(8))),
        "deep_cells": head + deep,
        "deep_cells_packed": head + packed(deep),
        "function": head + matrix("f", (1, 1), b"", of=16),
        "object": head + matrix("o", (1, 1), element(1, b"cls") + fields, of=3),
        "sparse": head + matrix("s", (1_000_000, 1_000_000), element(5, bytes(8)) + element(5, bytes(8)), of=5),
        "version_4": struct.pack("<5i", 0, 100_000_000, 20, 0, 2) + b"a\0",
        "version_7_3": b"MATLAB 7.3 MAT-file" + bytes(500),
        "hdf5": b"\x89HDF\r\n\x1a\n" + bytes(500),
        "twice": sound + sound[128:],
    }


def zipped(parts: Mapping[str, bytes | int], sound: bytes) -> bytes:
    """Return the sheet `sound` with other parts; a number stands for so many zeros."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(sound)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        for name in dict.fromkeys([*old.namelist(), *parts]):
            part = parts.get(name, b"") if name in parts else old.read(name)
            with new.open(name, "w", force_zip64=True) as file:
                if isinstance(part, int):
                    for _ in range(part >> 20):
                        file.write(bytes(1 << 20))
                else:
                    file.write(part)
    return out.getvalue()


def excels(sound: bytes) -> dict[str, bytes]:
    """Return damaged and hostile sheets."""
    sheet, strings = "xl/worksheets/sheet1.xml", "xl/sharedStrings.xml"
    with zipfile.ZipFile(io.BytesIO(sound)) as book:
        xml, types = book.read(sheet), book.read("[Content_Types].xml")
    kind = b"application/vnd.openxmlformats-officedocument.spreadsheetml.sharedStrings+xml"
    known = types.replace(
        b"</Types>", b'<Override PartName="/xl/sharedStrings.xml" ContentType="' + kind + b'"/></Types>'
    )
    space = b'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    laughs = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10 if k else "ha" * 10}">' for k in range(10)).encode()
    opened, row = b"<worksheet " + space + b"><sheetData>", b"</sheetData></worksheet>"
    return {
        "zeros_3_GB": zipped({sheet: 3 << 30}, sound),
        "zeros_beside": zipped({"xl/media/a.bin": 3 << 30}, sound),
        "strings_3e6": zipped({"[Content_Types].xml": known, strings: b"<sst " + space + b">" + b"<si><t>a</t></si>" * 3_000_000 + b"</sst>"}, sound),
        "string_of_200_MB": zipped({"[Content_Types].xml": known, strings: b"<sst " + space + b"><si><t>" + b"a" * 200_000_000 + b"</t></si></sst>"}, sound),
        "rows_empty_1e7": zipped({sheet: opened + b"<row/>" * 10_000_000 + row}, sound),
        "row_far": zipped({sheet: opened + b'<row r="1"><c r="A1"><v>1</v></c></row><row r="2000000000"><c r="A2000000000"><v>1</v></c></row>' + row}, sound),
        "cell_far": zipped({sheet: opened + b'<row r="1"><c r="XFD1"><v>1</v></c></row><row r="2"><c r="A2"><v>1</v></c></row>' + row}, sound),
        "cell_nowhere": zipped({sheet: opened + b'<row r="x"><c r="??"><v>1</v></c></row>' + row}, sound),
        "laughs": zipped({sheet: b"<!DOCTYPE a [" + laughs + b"]>" + opened + b"<row><c><v>&e9;</v></c></row>" + row}, sound),
        "deep": zipped({sheet: opened + b"<row>" * 500_000}, sound),
        "no_sheet": zipped({sheet: b""}, sound),
        "sheet_cut": zipped({sheet: xml[: len(xml) // 2]}, sound),
        "sheet_is_text": zipped({sheet: b"a,b\n1,2\n"}, sound),
        "not_a_book": zipped({"[Content_Types].xml": b"<Types/>"}, sound),
        "is_a_zip": gzip.compress(sound),
        "is_csv": b"enc_1,enc_2,enc_3\n1,2,3\n",
        "crc": re.sub(rb"PK\x01\x02(.{12}).{4}", lambda m: b"PK\x01\x02" + m[1] + b"\0\0\0\0", sound, flags=re.DOTALL),
    }  # fmt: skip


def parquets(rows: Rows) -> dict[str, bytes]:
    """Return hostile Parquet files."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    def made(table: Any, **how: Any) -> bytes:
        out = io.BytesIO()
        pq.write_table(table, out, **how)
        return out.getvalue()

    sound = as_parquet(rows)
    zeros = np.zeros(45_000_000, np.int8)
    word = pa.DictionaryArray.from_arrays(pa.array(np.zeros(20_000, np.int32)), pa.array(["x" * 1_000_000]))
    numbers = {name: [0.1, 0.2] for name in ("enc_1", "enc_2", "enc_3")}
    deep: Any = pa.array([[1.0], [2.0]])
    for _ in range(60):
        deep = pa.ListArray.from_arrays([0, 1, 2], deep)
    return {
        **{f"said_{name}": as_parquet(rows, said) for name, said in {
            "nothing": "", "list": "[]", "text": "gpm2002", "deep": "[" * 100_000, "huge_number": "9" * 5000,
            "other_machine": '{"machine": "delta"}', "no_machine": '{"machine": "warp"}', "sigma_text": '{"machine": "gpm2002", "sigma_enc": "small"}',
            "sigma_negative": '{"machine": "gpm2002", "sigma_enc": -1}', "sigma_zero": '{"machine": "gpm2002", "sigma_enc": 0}',
            "sigma_huge": '{"machine": "gpm2002", "sigma_enc": 1e308}', "sigma_nan": '{"machine": "gpm2002", "sigma_enc": NaN}',
            "teeth": '{"machine": "gpm2002", "sigma_enc": 5.5e-5, "tooth_numbers": [1e9, -3, 0]}',
            "nominal_list": '{"machine": "gpm2002", "nominal": [1]}', "nominal_huge": '{"machine": "gpm2002", "nominal": {"la1": 1e308}}',
            "twice": '{"machine": "gpm2002", "machine": "gpm2002"}', "surrogate": '{"machine": "\\ud800"}',
        }.items()},
        "zeros_4e7": made(pa.table({"enc_1": zeros})),
        "word_20_GB": made(pa.table({"split": word, **{n: np.zeros(20_000) for n in numbers}})),
        "bytes_20_GB": made(pa.table({"split": word.cast(pa.dictionary(pa.int32(), pa.binary())), **{n: np.zeros(20_000) for n in numbers}})),
        "list_of_1e8": made(pa.table({"enc_1": pa.array([np.zeros(100_000_000, np.int8)])})),
        "lists_in_lists": made(pa.table({**numbers, "deep": deep})),
        "struct": made(pa.table({**numbers, "s": [{"a": 1.0}, {"a": 2.0}]})),
        "fixed_bytes": made(pa.table({**numbers, "b": pa.nulls(2, pa.binary(1_000_000_000))})),
        "no_columns": made(pa.table({})),
        "no_rows": made(pa.table({n: pa.array([], pa.float64()) for n in numbers})),
        "decimals": made(pa.table({n: pa.array([1, 2], pa.int64()).cast(pa.decimal128(38, 18)) for n in numbers})),
        "dates": made(pa.table({n: pa.array([1, 2], pa.timestamp("ns")) for n in numbers})),
        "head_twice": made(pa.table([[0.1, 0.2]] * 3, names=["enc_1", "enc_1", "enc_2"])),
        "footer_long": sound[:-8] + struct.pack("<I", 2**31 - 1) + b"PAR1",
        "footer_zero": sound[:-8] + struct.pack("<I", 0) + b"PAR1",
        **{f"footer_flip_{i}": sound[:-500] + _flip(6)(sound[-500:-8], Random(i)) + sound[-8:] for i in range(6)},
        "encrypted": b"PARE" + sound[4:-4] + b"PARE",
    }  # fmt: skip


def yamls(sound: str) -> dict[str, str]:
    """Return study files that a parser cannot finish, or that are no study."""
    aliases = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [{','.join([f'*{chr(97 + i)}'] * 9)}]\n" for i in range(9)
    )
    merges = "a: &a {k: 1}\n" + "".join(
        f"b{i}: &{chr(98 + i)} {{{', '.join(f'k{j}: *{chr(97 + i)}' for j in range(9))}}}\n" for i in range(9)
    )
    return {
        "aliases": sound + aliases,
        "aliases_of_maps": sound + merges,
        "alias_of_itself": sound + "a: &a [*a]\n",
        "alias_of_nothing": sound + "a: *nobody\n",
        "deep": sound + "a: " + "[" * 50_000 + "]" * 50_000 + "\n",
        "deep_maps": sound + "a: " + "{a: " * 400 + "1" + "}" * 400 + "\n",
        "deep_open": "[" * 200_000,
        "large": sound + "".join(f"k{i}: {i}\n" for i in range(300_000)),
        "long_word": sound + f"description: {'x' * 5_000_000}\n",
        "many_words": f"sweeps:\n  - [{', '.join(['problem=full12'] * 40_000)}]\n",
        "huge_number": sound + "budget: " + "9" * 5000 + "\n",
        "tag": sound + "a: !!python/object/apply:os.system ['echo HACKED']\n",
        "binary": sound + "a: !!binary aGFsbG8=\n",
        "twice": sound + "sweeps: []\n",
        "documents": sound + "---\n" + sound,
        "interpolation": sound + "study: ${study}\n",
        "environment": sound + "study: ${oc.env:HOME}\n",
        "list": "- a\n- b\n",
        "nothing": "",
        "tabs": "\tsweeps:\n\t- a\n",
        "set": sound + "a: !!set {a, b}\n",
        "date": sound + "budget: 2024-05-01\n",
        "merge_key": sound + "a: &a {b: 1}\nc: {<<: *a}\n",
    }


def _ignored(*_: Any) -> None:
    return None


SPECIAL: dict[str, Callable[[Path], None]] = {  # no regular files, and large ones
    "pipe": os.mkfifo,
    "folder": lambda path: path.mkdir(),
    "zero": lambda path: path.symlink_to("/dev/zero"),
    "random": lambda path: path.symlink_to("/dev/urandom"),
    "broken_link": lambda path: path.symlink_to("nowhere"),
    "loop": lambda path: path.symlink_to(path),
    "10_GB": lambda path: _ignored(path.touch(), os.truncate(path, 10**10)),
    "line_of_90_MB": lambda path: _ignored(path.write_bytes(b"a" * 90_000_000)),
    "random_90_MB": lambda path: _ignored(path.write_bytes(os.urandom(90_000_000))),
    "commas_90_MB": lambda path: _ignored(path.write_bytes(b"1," * 45_000_000)),
    "spaces_90_MB": lambda path: _ignored(path.write_bytes(b" " * 90_000_000)),
    "quotes": lambda path: _ignored(path.write_bytes(b'"' * 3_000_001)),
    "lines_quoted": lambda path: _ignored(path.write_bytes(b'a,b\n"' + b"1,2\n" * 500_000)),
    "brackets": lambda path: _ignored(path.write_bytes(b"[" * 200_000)),
    "open_brackets": lambda path: _ignored(path.write_bytes(b"enc_1 [" * 100_000 + b"\n1\n")),
}
AT_DOORS = ("gpm_csv", "gpm_parquet", "gpm_excel", "gpm_matlab", "urdf", "study", "printer", "dh", "hand_eye")


# ---- all cases


def doors() -> list[Door]:
    """Return the doors, and write the sound files beside the damaged ones into the working folder."""
    for name in ("arm/six.urdf", "arm/demo_sound.csv", "delta/printer.cfg", "mount/demo_still.dat"):
        shutil.copy(DEMO / name, Path(name).name)
    Path("dh_readings.csv").write_bytes(dh_readings())
    Path("dh.csv").write_bytes(table_text(DH_ROWS))
    gpm = [[*row[:8], row[20]] for row in demo_rows("gpm2002/demo_nothing.csv", 90)]
    arm, enso = demo_rows("arm/demo_sound.csv", 60), demo_rows("table/demo_enso.csv", 168)
    study = "description: a study\nproblem: full11\noptimizer: de\nbudget: 20\nseeds: 1\nsweeps:\n  - [start=nominal]\n"
    of_gpm = "discover machine=gpm2002 data={} pages=none sigma_enc=5.5e-5"
    of_arm = "calibrate urdf=six.urdf data={} page=false resamples=20"
    found = [
        Door("gpm_csv", of_gpm, ".csv", b"", gpm),
        Door("gpm_excel", of_gpm, ".xlsx", as_excel(gpm), gpm),
        Door("gpm_matlab", of_gpm, ".mat", as_matlab(gpm), gpm),
        Door("gpm_parquet", of_gpm, ".parquet", as_parquet(gpm), gpm),
        Door("arm_csv", of_arm, ".csv", b"", arm),
        Door("arm_discover", "discover machine=arm machine.urdf=six.urdf data={} pages=none", ".csv", b"", arm),
        Door("table", "discover machine=table machine.model=line machine.inputs=[month] data={} pages=none", ".csv", b"", enso),
        Door("hand_eye", "calibrate hand_eye=eye_in_hand data={}", ".csv", b"", hand_eye_rows()),
        Door("dh", "calibrate dh={} convention=standard data=dh_readings.csv page=false resamples=20", ".csv", b"", DH_ROWS),
        Door("planar", "run problem=full11 problem.readings={} optimizer=lm budget=40 seeds=1", ".csv", b"", [row[5:8] for row in gpm]),
        Door("orthoglide", "run problem=orthoglide6 problem.readings={} optimizer=lm budget=40 seeds=1", ".csv", b"", orthoglide_rows()),
        Door("urdf", "calibrate urdf={} data=demo_sound.csv page=false resamples=20", ".urdf", (DEMO / "arm/six.urdf").read_bytes()),
        Door("urdf_discover", "discover machine=arm machine.urdf={} data=demo_sound.csv pages=none", ".urdf", (DEMO / "arm/six.urdf").read_bytes()),
        Door("printer", "discover machine=delta data={} pages=none", ".cfg", (DEMO / "delta/printer.cfg").read_bytes()),
        Door("tpoint", "discover machine=mount data={} pages=none", ".dat", (DEMO / "mount/demo_still.dat").read_bytes()),
        Door("study", "run study={}", ".yaml", study.encode()),
    ]  # fmt: skip
    return [Door(d.name, d.words, d.ending, d.sound or table_text(d.rows or []), d.rows) for d in found]


WRITERS: dict[str, Callable[[Rows], bytes]] = {
    ".csv": table_text, ".xlsx": as_excel, ".mat": as_matlab, ".parquet": as_parquet
}  # fmt: skip
FEW = ("arm_discover", "urdf_discover")  # doors whose reader another door has tried: tables and kinds alone


def cases(door: Door) -> Iterator[tuple[str, bytes]]:
    """Yield the damaged files of a door, by name."""
    yield "sound", door.sound
    text = door.ending in (".csv", ".urdf", ".cfg", ".dat", ".yaml")
    if door.name not in FEW:
        for name, damage in {**BYTES, **(TEXTS if text else {})}.items():
            yield name, damage(door.sound, Random(f"{door.name} {name}"))
    for name, change in (TABLES if door.rows else {}).items():
        if door.ending == ".csv" or not name.startswith(("head_twice", "ragged", "no_head", "wide")):
            rows = [list(row) for row in door.rows or []]
            try:
                yield f"table_{name}", WRITERS[door.ending](change(rows, Random(f"{door.name} {name}")))
            except (ValueError, TypeError, OverflowError):  # what this kind of file cannot hold
                continue
    own: dict[str, Any] = {}
    if door.ending == ".urdf":
        own = urdfs(door.sound.decode())
    elif door.name == "study":
        own = yamls(door.sound.decode())
    elif door.rows and door.ending != ".csv":
        kind = {".mat": matlabs, ".xlsx": excels}.get(door.ending)
        own = kind(door.sound) if kind else parquets(door.rows)
    for name, content in own.items():
        yield name, content.encode("latin-1" if "latin" in name else "utf-8") if isinstance(content, str) else content


# ---- running


def run(case: Case, place: Path) -> Outcome:
    """Return what came of one command, in a forked process."""
    home = place / case.name
    home.mkdir(parents=True)
    for shared in place.glob("*.*"):
        if shared.is_file():
            (home / shared.name).symlink_to(shared.resolve())
    file = home / f"damaged{case.ending}"
    if case.special is None:
        case.written.rename(file)
    else:
        case.special(file)
    outcome = Outcome(case.name, forked.run(case.words, home))
    shutil.rmtree(home)
    return outcome


def _write(only: str) -> None:
    """Write the damaged files: in a process of its own, whose memory and threads the commands do not inherit."""
    pid = os.fork()
    if pid:
        if os.waitpid(pid, 0)[1]:
            raise RuntimeError("the damaged files could not be written")
        return
    try:
        Path("files").mkdir()
        known = doors()
        for door in known:
            for name, content in cases(door) if only.partition("-")[0] in door.name else ():
                if only in f"{door.name}-{name}":
                    (Path("files") / f"{door.name}-{name}").write_bytes(content)
        Path("doors.json").write_text(json.dumps([(door.name, door.words, door.ending) for door in known]))
    except BaseException:
        import traceback

        traceback.print_exc()
        os._exit(1)
    os._exit(0)


def _cases(only: str) -> list[Case]:
    _write(only)
    found = []
    for door, words, ending in json.loads(Path("doors.json").read_text()):
        told = [word.replace("{}", f"damaged{ending}") for word in words.split()]
        files = [(path.name, path.resolve(), None) for path in sorted(Path("files").glob(f"{door}-*"))]
        special = [(f"{door}-{name}", Path(), make) for name, make in SPECIAL.items() if door in AT_DOORS]
        found += [Case(name, told, *how, ending) for name, *how in (*files, *special) if only in name]
    Path("doors.json").unlink()
    return found


def main() -> int:
    """Run all cases and tell what came of them."""
    parser = argparse.ArgumentParser(prog="benchmarks.damaged", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--to", type=Path, default=Path("results/benchmarks/damaged"))
    parser.add_argument("--only", default="", help="a part of a case's name, such as urdf- or gpm_csv-table")
    asked = parser.parse_args()
    shutil.rmtree(asked.to, ignore_errors=True)
    asked.to.mkdir(parents=True)
    os.chdir(asked.to)
    forked.load()
    outcomes = [run(case, Path().resolve()) for case in _cases(asked.only)]
    lines = [json.dumps({"name": one.name, "wrong": one.wrong, **one.ended._asdict()}) for one in outcomes]
    Path("outcomes.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    for one in outcomes:
        if one.ended.code != 2:
            print(f"taken {one.name} ({one.ended.code}): {' | '.join(one.ended.said.splitlines())}")
    wrong = [one for one in outcomes if one.wrong]
    for one in wrong:
        cpu, memory = one.ended.cpu, one.ended.memory / 1e6
        print(f"WRONG {one.name}: {one.wrong}; {cpu:.1f} s, {memory:.0f} MB: {one.ended.said[-300:]!r}")
    slowest, largest = max(one.ended.cpu for one in outcomes), max(one.ended.memory for one in outcomes)
    refused = [one.ended.cpu for one in outcomes if one.ended.code == 2]
    print(
        f"{len(outcomes)} files: {len(refused)} refused (at most {max(refused, default=0):.1f} s), "
        f"{len(outcomes) - len(refused)} taken, {len(wrong)} wrong; "
        f"at most {slowest:.1f} s of CPU and {largest / 1e6:.0f} MB"
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
