"""Searches in nights of stars: shipped, simulated and real."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.measured import read_measured, shipped_path
from calibench.bench.measured.sources import sources
from calibench.discrepancy import DataError, MeasuredData
from calibench.discrepancy.checks.validate import validate
from calibench.discrepancy.machines.mount import Mount
from calibench.discrepancy.machines.mount.description import planned, pointing_model
from calibench.discrepancy.model.machine import Formulation, Machine
from tests.independent.mount import case

pytestmark = pytest.mark.usefixtures("at_one_noise")

GIVEN = Path(os.environ.get("CALIBENCH_DATA", Path(__file__).parents[4] / "shared" / "data"))
REAL = GIVEN / "telescope_pointing"
needs_real = pytest.mark.skipif(
    not REAL.is_dir(),
    reason=f"no measured nights at {GIVEN}; CALIBENCH_DATA names a folder that has telescope_pointing",
)


@pytest.fixture(scope="module")
def flexure() -> discrepancy.Report:
    return discrepancy.explain("mount", read_measured(shipped_path("demo_flexure", "mount"), "mount"))


def test_a_drooping_tube_is_named(flexure: discrepancy.Report) -> None:
    assert flexure.verdict == "named"
    assert flexure.findings[0].effect == "TF mount"
    assert flexure.findings[0].amplitude.unit == "arcsec"


def test_the_pointing_model_has_every_term_with_its_deviation(flexure: discrepancy.Report) -> None:
    told = pointing_model(flexure)
    assert told is not None
    lines = told.text.splitlines()
    assert [line.split()[0] for line in lines[2:-1]] == ["IH", "ID", "CH", "NP", "MA", "ME", "TF"]
    assert lines[-1] == "END"
    assert float(lines[8].split()[1]) == pytest.approx(flexure.findings[0].amplitude.value, abs=0.01)


def test_a_label_that_was_shuffled_names_nothing(flexure: discrepancy.Report) -> None:
    """The readings change places among the stars' errors: the mount's terms have nothing to follow any more."""
    data = flexure.before.model.formulation.data
    mixed = np.random.default_rng(0).permutation(len(data))
    errors = {name: np.asarray(data[name])[mixed] - np.mean(data[name]) for name in ("dX", "dDec")}
    there = flexure.before.model.formulation
    left = np.asarray(flexure.before.model.residuals(flexure.before.best)).real
    found = data.with_columns({name: np.asarray(data[name]) - left[:, k] + left[mixed, k]
                               for k, name in enumerate(errors)})  # fmt: skip

    class Shuffled:
        name = "mount"

        def formulate(self, data: MeasuredData) -> object:
            return there.on(data)

    report = discrepancy.explain(Shuffled(), found)  # type: ignore[arg-type]
    assert "TF mount" not in [f.effect for f in report.findings]


def test_a_design_sees_the_droop_of_the_tube() -> None:
    formulation = Mount().formulate(planned(n=60))
    assert [p.name for p in formulation.parameters] == ["IH", "ID", "CH", "NP", "MA", "ME"]
    assert len(Mount(base="index").formulate(planned(n=60, mount="altaz")).parameters) == 2


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"latitude_deg": None}, "latitude"),
        ({"mount": "dobson"}, "equatorial or altaz"),
        ({"sigma_arcsec": -3}, "sigma_arcsec"),
    ],
)
def test_what_is_stated_wrongly_is_told(change: dict[str, object], said: str) -> None:
    data = planned(n=20)
    with pytest.raises(DataError, match=said):
        Mount().formulate(replace(data, metadata={**data.metadata, **change}))


def test_degrees_for_radians_and_a_star_below_the_horizon_are_told() -> None:
    data = planned(n=20)
    with pytest.raises(DataError, match="units=ha:deg"):
        Mount().formulate(data.with_columns({"ha": np.degrees(np.asarray(data["ha"]))}))
    with pytest.raises(DataError, match="below the horizon"):
        Mount().formulate(data.with_columns({"star_dec": np.full(20, -1.5)}))


def test_both_ways_to_tell_the_side_of_the_pier_are_one() -> None:
    data = planned(n=40)
    over = np.cos(data["dec"]) < 0
    words = data.with_columns({
        "ha": np.where(over, data["ha"] - np.pi, data["ha"]), "dec": np.where(over, np.pi - data["dec"], data["dec"]),
        "pier_side": np.where(over, "west", "east"),
    })  # fmt: skip
    one, other = (Mount().formulate(d).data for d in (data, words))
    np.testing.assert_allclose(one["side"], other["side"])
    np.testing.assert_allclose(one["dX"], other["dX"], atol=1e-6)


@pytest.mark.slow
def test_the_fault_of_a_simulated_night_is_in_the_set() -> None:
    hits = []
    for k in range(8):
        night = case(k, only="TF", visible=2.0, altaz=False)
        report = discrepancy.explain("mount", MeasuredData(night.columns, "mount", night.stated, str(k)))
        hits.append("TF mount" in [r.effect for f in report.findings for r in f.set])
    assert sum(hits) >= 7


@needs_real
@pytest.mark.slow
@pytest.mark.parametrize(("name", "rms"), [("warp-astron", 76.0), ("gem-28", 168.0), ("cgx-l-data", 189.0)])
def test_a_real_mount_points_better_than_was_told(name: str, rms: float) -> None:
    report = discrepancy.explain("mount", read_measured(REAL / f"{name}.dat", "mount"))
    left = report.model.model.residuals(report.model.best).real
    assert np.sqrt(np.mean(np.sum(left**2, axis=1))) <= rms
    assert report.verdict != "unknown"
    assert report.verdict == "partly" or report.gap.train_after < 1.5 * report.gap.noise_floor


@pytest.mark.slow
@pytest.mark.parametrize(("k", "term"), [pytest.param(61, "PHH", marks=pytest.mark.slow), (71, "FO")])
def test_a_large_term_whose_form_is_off_keeps_its_name(k: int, term: str) -> None:
    night = case(k)
    report = discrepancy.explain("mount", MeasuredData(night.columns, "mount", night.stated, "night"))
    assert night.truth == term
    assert report.verdict in ("named", "ambiguous", "partly")
    assert f"{term} mount" in {rival.effect for rival in report.findings[0].set}


@pytest.mark.slow
def test_what_is_in_no_catalogue_is_not_plainly_named_where_nobody_states_the_noise() -> None:
    night = case(1)  # something that creeps after a while: told as a slip, the rest of it still shows
    report = discrepancy.explain("mount", MeasuredData(night.columns, "mount", night.stated, "night"))
    assert night.truth == "creep"
    assert report.verdict in ("partly", "unknown")


def _waved() -> MeasuredData:
    """Return a night of a tube that droops by ten times the noise, and of errors that no term of the field is."""
    night = case(3, only="TF", visible=12.0, altaz=False)
    dec, ha = (np.asarray(night.columns[name]) for name in ("dec", "ha"))
    off = 8 * night.sigma * (np.sign(np.sin(3 * dec + 0.5)) + np.abs(np.sin(2 * ha + 0.3)))
    star = np.asarray(night.columns["star_dec"]) + np.radians(off / 3600)
    return MeasuredData({**night.columns, "star_dec": star}, "mount", night.stated, "night")


@pytest.mark.slow
def test_a_name_that_stands_beside_smooth_functions_is_told_where_more_is_missing() -> None:
    report = discrepancy.explain("mount", _waved())
    assert report.verdict == "partly"
    assert report.findings[0].effect == "TF mount"


@dataclass(frozen=True)
class Relabelled:
    """A mount whose stars have changed one of their labels among each other: the time, or the side of the pier."""

    label: str
    name: str = "mount"

    def formulate(self, data: MeasuredData) -> Formulation:
        there = Mount().formulate(data)
        mixed = np.random.default_rng(1).permutation(len(there.data))
        return there.on(there.data.with_columns({self.label: np.asarray(there.data[self.label])[mixed]}))


def _named(data: MeasuredData, machine: Machine) -> list[str]:
    found = discrepancy.explain(machine, data).findings
    return [rival.effect for finding in found for rival in finding.set]


@needs_real
@pytest.mark.slow
@pytest.mark.parametrize("name", ["warp-astron", "gem-28", "cgx-l-data"])
def test_what_goes_with_the_time_goes_when_the_times_of_a_real_night_are_shuffled(name: str) -> None:
    data = read_measured(REAL / f"{name}.dat", "mount")
    true, mixed = (
        {found for found in _named(data, machine) if found.split()[0] in ("drift", "slip")}
        for machine in (Mount(), Relabelled("t_s"))
    )
    assert true
    assert not mixed


@needs_real
@pytest.mark.slow
def test_what_goes_with_the_pier_goes_when_the_sides_of_a_real_night_are_shuffled() -> None:
    data = read_measured(REAL / "gem-28.dat", "mount")
    timeless = replace(data, columns={n: c for n, c in data.columns.items() if n != "t_s"})
    true, mixed = (
        {found for found in _named(timeless, machine) if found.startswith("pier_")}
        for machine in (Mount(), Relabelled("side"))
    )
    assert true
    assert not mixed


def test_a_column_that_nothing_reads_is_told_with_the_name_it_may_have_been_meant_for() -> None:
    data = planned(n=20)
    columns = {**data.columns, "temp_C": np.linspace(20, 12, len(data)), "humidity": np.linspace(40, 60, len(data))}
    notes = validate(Mount(), replace(data, columns=columns)).data.notes
    [unread] = [note for note in notes if note.code == "columns_unread"]
    assert unread.columns == ("temp_C", "humidity")
    assert str(unread).endswith("""did you mean temp_K? columns='{"temp_K":"temp_C"}'""")
    known = validate(Mount(), data.with_columns({"temp_K": columns["temp_C"]})).data.notes
    assert not [note for note in known if note.code == "columns_unread"]


@pytest.mark.parametrize(
    ("machine", "name"),
    [("orthoglide", "exp1"), ("delta", "printer"), ("gpm2002", "demo_warm_tracked"), ("mount", "demo_flexure")],
)
def test_no_column_of_a_set_that_ships_is_told_as_unread(machine: str, name: str) -> None:
    [source] = sources(name, machine)
    notes = validate(discrepancy.machines.make(machine), source.read({})).data.notes
    assert not [note for note in notes if note.code == "columns_unread"]
