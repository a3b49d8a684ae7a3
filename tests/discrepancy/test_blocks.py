"""`Blocks`: readings of different kinds in one fit."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.discrepancy import Blocks, Constraints, DataError, MeasuredData, Predicted, explain
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import Joint, Roles
from calibench.problems.base import Parameter

TRUE = {"scale": 1.004, "tilt": 0.02, "up": 0.3}
SCALE = Parameter("scale", "1", 1.0, 0.9, 1.1)
PARAMETERS = (SCALE, Parameter("tilt", "1", 0.0, -1.0, 1.0), Parameter("up", "mm", 0.0, -5.0, 5.0))
ROLES = Roles((Joint("axis u", "u", "sliding"),))


def height(q):
    return q["tilt"] * q["scale"] * q["u"] + q["up"]


def both(q):
    return np.stack([height(q), 2 * q["scale"] * q["u"]], axis=-1)


def length(q):
    return q["scale"] * (q["v"] - q["u"])


def readings(seed=0, n=40, m=25):
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(-100, 100, n + m), rng.uniform(100, 200, n + m)
    q = TRUE | {"u": u, "v": v}
    kind = np.where(np.arange(n + m) < n, "height", "distance")
    z = np.where(kind == "height", height(q) + 0.02 * rng.standard_normal(n + m), np.nan)
    w = np.where(kind == "height", 2 * TRUE["scale"] * u + 0.03 * rng.standard_normal(n + m), np.nan)
    d = np.where(kind == "distance", length(q) + 0.05 * rng.standard_normal(n + m), np.nan)
    split = np.where(np.arange(n + m) % 4 == 0, "hold", "train")
    return MeasuredData({"kind": kind, "u": u, "v": v, "z": z, "w": w, "d": d, "split": split}, "probe", {}, "probe")


def parts(data, wide=False, noise=(0.02, 0.05)):
    keep = {"height": ("u", "z", "split", *("w",) * wide), "distance": ("u", "v", "d", "split")}
    rows = {kind: data.rows(data["kind"] == kind) for kind in keep}
    rows = {
        kind: MeasuredData({name: part[name] for name in keep[kind]}, "probe", {}, "probe")
        for kind, part in rows.items()
    }
    measured = {"z": noise[0], "w": 0.03} if wide else {"z": noise[0]}
    first = Predicted(rows["height"], both if wide else height, PARAMETERS, measured, inputs=("u",), roles=ROLES)
    return first, Predicted(rows["distance"], length, (SCALE,), {"d": noise[1]}, inputs=("u", "v"))


class Probe:
    name = "probe"

    def __init__(self, wide=False, noise=(0.02, 0.05)):
        self.more = {"wide": wide, "noise": noise}

    def formulate(self, data):
        return Blocks(*parts(data, **self.more))


@pytest.mark.parametrize("wide", [False, True])
def test_heights_and_distances_are_fitted_together(wide):
    report = explain(Probe(wide), readings())
    assert report.verdict == "none"
    for name, true in TRUE.items():
        told = report.parameters[name]
        assert abs(told.after - true) < 4 * told.sd
    assert report.gap.held_out_after == pytest.approx(1.0, abs=0.3)


def test_the_whole_is_each_block_row_by_row():
    formulation = Blocks(*parts(readings()))
    x = np.array([TRUE[p.name] for p in formulation.parameters])
    whole = Model(formulation).residuals(x)
    J = Model(formulation).jacobian(x)
    names = [p.name for p in formulation.parameters]
    for k, part in enumerate(parts(readings())):
        own = [names.index(p.name) for p in part.parameters]
        np.testing.assert_array_equal(whole[formulation.data["block"] == k], Model(part).residuals(x[own]))
        np.testing.assert_array_equal(J[formulation.data["block"] == k][:, :, own], Model(part).jacobian(x[own]))
    assert not J[formulation.data["block"] == 1][:, :, [names.index("tilt"), names.index("up")]].any()


def test_blocks_weigh_by_their_own_noise():
    quiet, loud = (explain(Probe(noise=(0.02, s)), readings()).parameters["scale"].sd for s in (0.05, 0.5))
    assert loud > 5 * quiet


def test_rows_in_any_order_are_those_of_their_block():
    formulation = Blocks(*parts(readings()))
    order = np.random.default_rng(1).permutation(len(formulation.data))
    x = np.array([1.0, 0.1, 0.2])
    there = Model(formulation.on(formulation.data.rows(order)))
    np.testing.assert_array_equal(there.residuals(x), Model(formulation).residuals(x)[order])


def test_blocks_of_more_constraints_are_parted_and_counted_once():
    formulation = Blocks(*parts(readings(), wide=True))
    assert formulation.constraints(Model(formulation).quantities(np.array([1.0, 0.0, 0.0]))[1]).shape == (105, 1)
    assert [len(block.data) for block in formulation.blocks] == [40, 40, 25]


def test_repeats_are_those_of_one_block():
    first, second = parts(readings())
    same = [part.on(part.data.with_columns({"visit_id": np.arange(len(part.data)) // 2})) for part in (first, second)]
    data = Blocks(*same).data
    assert len(np.unique(data["visit_id"])) == 20 + 13
    assert len(np.unique(np.stack([data["visit_id"], data["block"]]), axis=1).T) == 20 + 13


def test_wild_readings_in_one_block_are_not_made_up_by_the_rows_of_the_other():
    first, second = parts(readings(n=90, m=90))
    rng = np.random.default_rng(3)
    twice = [np.repeat(np.arange(len(part.data)), 2) for part in (first, second)]
    again = []
    for part, rows, sigma in zip((first, second), twice, (0.02, 0.05)):
        [name] = part.readings
        data = part.data.rows(rows).with_columns({"visit_id": rows})
        x = np.array([TRUE[p.name] for p in part.parameters])
        there = Model(part.on(data))
        true = np.asarray(data[name]) - there.residuals(x)[:, 0]
        again.append(part.on(data.with_columns({name: true + sigma * rng.standard_normal(len(rows))})))

    class Twice:
        name = "probe"

        def formulate(self, data):
            return Blocks(*again)

    assert explain(Twice(), again[0].data).verdict == "none"


def test_what_one_block_lacks_is_told():
    first, second = parts(readings())
    warm = first.on(first.data.with_columns({"temp_K": np.linspace(0, 5, len(first.data))}))
    assert "column temp_K: not in every block; 0 is taken where missing" in map(str, Blocks(warm, second).data.notes)


def test_roles_and_unknown_noise_are_those_of_all_blocks():
    formulation = Blocks(*parts(readings(), noise=(None, 0.05)))
    assert formulation.roles == ROLES
    assert formulation.unknown_noise == ("z",)
    assert abs(np.log(np.median(formulation.sigma["z"]) / 0.02)) < 0.6


def test_blocks_that_contradict_each_other_are_refused():
    first, second = parts(readings())
    other = Predicted(second.data, lambda q: q["up"] * q["u"], (), {"d": 0.05}, inputs=("u",), held={"up": 1.0})
    with pytest.raises(DataError, match="up is free in one"):
        Blocks(first, other)
    wider = Parameter("scale", "1", 1.0, 0.5, 1.5)
    with pytest.raises(DataError, match="scale is free differently"):
        Blocks(first, Predicted(second.data, length, (wider,), {"d": 0.05}, inputs=("u", "v")))


def test_a_closure_of_several_constraints_stands_beside_others_of_as_many_only():
    first, _ = parts(readings())
    closed = Constraints(
        first.data, lambda q: np.stack([q["z"] - q["up"], q["z"] + q["scale"]], axis=-1), PARAMETERS, {"z": 0.02}
    )
    with pytest.raises(DataError, match="several constraints beside a block"):
        Blocks(closed, parts(readings())[1])


@pytest.mark.parametrize("empty", [np.nan, 0.0])
def test_rows_of_two_kinds_are_parted_by_a_column_and_new_ones_are_predicted(empty):
    """What the other kind reads is empty in a file, or anything else: it is not looked at."""

    class Stage(Probe):
        def formulate(self, data):
            high = data["kind"] == "height"
            first = Predicted(data.rows(high), height, PARAMETERS, {"z": 0.02}, inputs=("u",), roles=ROLES)
            return Blocks(first, Predicted(data.rows(~high), length, (SCALE,), {"d": 0.05}, inputs=("u", "v")))

    data = readings()
    data = data.with_columns({name: np.where(np.isnan(data[name]), empty, data[name]) for name in ("z", "d")})
    data = MeasuredData({name: c for name, c in data.columns.items() if name != "w"}, "probe", {}, "probe")
    report = explain(Stage(), data)
    assert report.verdict == "none"
    held = data.rows(data["split"] == "hold")
    told, high = report.predict(held), held["kind"] == "height"
    for name, there, sigma in (("z", high, 0.02), ("d", ~high, 0.05)):
        np.testing.assert_array_equal(np.isfinite(told.measured[name]), there)
        assert np.std(held[name][there] - told.measured[name][there]) < 2 * sigma
    with pytest.raises(DataError, match="leaves columns out"):
        explain(Probe(), readings()).predict(readings())
