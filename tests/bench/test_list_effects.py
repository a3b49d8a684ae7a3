"""`bench list effects` and `bench list machines`: what the search for a missing effect knows."""

from __future__ import annotations

import json

import pytest

from calibench.bench.cli import main


def listed(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main(["list", *argv])
    assert ended.value.code == 0
    return capsys.readouterr().out


def test_effects_are_listed_with_what_they_need(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [row for row in json.loads(listed(capsys, "effects", "--json")) if row["machine"] == "gpm2002"]
    assert len(rows) == 21
    [backlash] = [row for row in rows if row["name"] == "backlash"]
    assert backlash["columns"] == ["dir_{i}"]
    assert backlash["targets"] == ["joint 1", "joint 2", "joint 3"]
    assert backlash["unit"] == "rad"


def test_effects_are_printed_with_their_machine_and_formula(capsys: pytest.CaptureFixture[str]) -> None:
    lines = listed(capsys, "effects").splitlines()
    at = lines.index("gear  [gpm2002, reading]")
    assert "enc_i += k enc_i" in lines[at + 1]


def test_machines_are_listed_with_their_effects(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {row["name"]: row for row in json.loads(listed(capsys, "machines", "--json"))}
    assert "tracker_lag" in rows["gpm2002"]["effects"]
    assert rows["gpm2002"]["options"] == []
