"""Laws of the GPM2002 as a measured machine: it closes at the truth, its slopes are derivatives, it starts anywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibench.discrepancy import machines
from calibench.discrepancy.machines.gpm2002.description import planned
from calibench.discrepancy.model.machine import complex_step_slopes
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.problems.planar.gpm2002 import NAMES, makers_machine

BRANCHES = [(1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, -1.0, -1.0)]


def a_machine(rng: np.random.Generator) -> dict[str, float]:
    """Return a machine some millimetres from the maker's, with offsets anywhere."""
    truth = makers_machine() + np.r_[rng.normal(0, 2.0, 12), rng.uniform(-3, 3, 3)]
    return dict(zip(NAMES, truth.tolist()))


def with_nominal(data: MeasuredData, nominal: dict[str, float], **more: object) -> MeasuredData:
    return replace(data, metadata={**data.metadata, "nominal": nominal, **more})


@pytest.mark.parametrize("tracked", [False, True])
@pytest.mark.parametrize("branches", BRANCHES)
def test_a_machine_read_without_noise_closes_at_its_truth(branches: tuple[float, ...], tracked: bool) -> None:
    for seed in range(3):
        truth = a_machine(np.random.default_rng(seed))
        data = planned(n=30, radius=90, seed=seed, tracked=tracked, machine=truth, branches=branches)
        closure = machines.make("gpm2002").formulate(data)
        q = {**truth, **{name: data[name] for name in closure.readings}}
        assert np.abs(closure.constraints(q)).max() < 1e-9  # mm


@pytest.mark.parametrize("tracked", [False, True])
def test_slopes_agree_with_a_complex_step(tracked: bool) -> None:
    truth = a_machine(np.random.default_rng(5))
    closure = machines.make("gpm2002").formulate(planned(n=25, tracked=tracked, machine=truth))
    model = Model(closure)
    q = model.quantities(model.start + 1e-3)[0]  # where the legs do not meet
    exact, ours = complex_step_slopes(closure, q), closure.slopes(q)
    assert set(ours) == set(exact)
    for name, slope in ours.items():
        assert np.allclose(slope, exact[name], rtol=1e-9, atol=1e-9 * np.abs(exact[name]).max()), name


@pytest.mark.slow
@pytest.mark.parametrize("tracked", [False, True])
@pytest.mark.parametrize("branches", BRANCHES)
def test_the_start_is_near_the_truth_whatever_the_offsets_and_elbows(
    branches: tuple[float, ...], tracked: bool
) -> None:
    for seed in range(3):
        truth = a_machine(np.random.default_rng(100 + seed))
        data = planned(n=40, radius=90, seed=seed, tracked=tracked, machine=truth, branches=branches)
        near = {name: truth[name] + (-0.3, 0.3)[seed % 2] for name in ("z1", "z2", "z3")}
        for nominal in ({}, near):
            start = {
                p.name: p.start for p in machines.make("gpm2002").formulate(with_nominal(data, nominal)).parameters
            }
            for name in near:
                off = np.angle(np.exp(1j * (start[name] - truth[name])))
                assert abs(off) < 0.1, (nominal, name, off)


def test_stated_offsets_keep_their_turn() -> None:
    truth = a_machine(np.random.default_rng(1))
    nominal = {**truth, "z2": truth["z2"] + 4 * np.pi}
    closure = machines.make("gpm2002").formulate(with_nominal(planned(machine=truth), nominal))
    assert {p.name: p.start for p in closure.parameters}["z2"] == pytest.approx(nominal["z2"], abs=0.1)


def test_angles_only_leave_eleven_parameters_and_a_tracker_fifteen() -> None:
    machine = machines.make("gpm2002")
    assert len(machine.formulate(planned()).parameters) == 11
    assert len(machine.formulate(planned(tracked=True)).parameters) == 15


@pytest.mark.parametrize(
    ("held", "free"),
    [
        (("la1",), 11), (("xa1", "ya1", "xa3", "ya3"), 11), (("lb2", "z1", "ya3"), 11),
        (("xa1", "la1", "lb1"), 10),  # two lengths: one of them is more than the gauge asks for
    ],
)  # fmt: skip
def test_what_is_held_replaces_the_gauge_as_far_as_it_goes(held: tuple[str, ...], free: int) -> None:
    data = planned(n=40)
    closure = machines.make("gpm2002").formulate(with_nominal(data, data.metadata["nominal"], fixed_parameters=held))
    names = [p.name for p in closure.parameters]
    assert not set(held) & set(names)
    jacobian = Model(closure).jacobian(Model(closure).start)[:, 0, :]
    values = np.linalg.svd(jacobian / np.linalg.norm(jacobian, axis=0), compute_uv=False)
    assert values[-1] > 1e-7 * values[0]  # nothing moves unseen
    assert len(names) == free


def test_values_of_held_parameters_are_taken_from_the_metadata() -> None:
    data = planned(n=40, machine={"lb2": 250.0})
    data = with_nominal(data, {}, fixed_parameters={"lb2": 250.0})
    assert machines.make("gpm2002").formulate(data).fixed["lb2"] == 250.0


def test_covariates_are_what_varies_leg_by_leg_and_the_place() -> None:
    data = planned(n=30, tracked=True, without=("tau",))
    data = data.with_columns({"temp_K": np.zeros(len(data))})
    closure = machines.make("gpm2002").formulate(data)
    told = closure.covariates(Model(closure).quantities(Model(closure).start)[0])
    assert set(told) == {"leg 1", "leg 2", "leg 3", "workspace"}
    assert {"enc_1", "enc_2", "enc_3", "t_s", "vel_2", "dir_2", "axial_2"} <= set(told["leg 2"])
    assert not {"temp_K", "tau_2", "vel_1"} & set(told["leg 2"])
    assert all(len(column) == len(data) for columns in told.values() for column in columns.values())
    assert np.array_equal(told["workspace"]["x"], data["x"])
