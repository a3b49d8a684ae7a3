"""Kinematics of an arm: against complex steps, a slow twin, Pinocchio where it stands, and the compiled lanes."""

import math

import numpy as np
import pytest

from calibench.calibration import kinematics as K, kinematics as R, parse_urdf, read_urdf
from calibench.calibration.determined import gauge, observability
from calibench.calibration.dh import DhRow, DhTable
from calibench.calibration.kinematics import constants
from calibench.calibration.rigid import quaternion, rpy, rpy_of, shift
from calibench.calibration.walk import READING, quantities, slopes, walk
from calibench.problems.arm.families import shipped

ODD = """<robot name="odd">
  <link name="ground"/><link name="cart"/><link name="arm"/><link name="hand"/><link name="claw"/><link name="plate"/>
  <joint name="rail" type="prismatic"><parent link="ground"/><child link="cart"/>
    <origin xyz=".1 .2 .3" rpy=".3 -.2 1.1"/><axis xyz="1 2 -2"/><limit lower="-.4" upper=".6"/></joint>
  <joint name="bolt" type="fixed"><parent link="cart"/><child link="plate"/>
    <origin xyz="0 0 .05" quat_xyzw="0 0 .6 .8"/></joint>
  <joint name="swing" type="continuous"><parent link="plate"/><child link="arm"/>
    <origin xyz=".4 0 0" rpy="0 1.2 .1"/><axis xyz="0 3 4"/></joint>
  <joint name="echo" type="revolute"><parent link="arm"/><child link="hand"/>
    <origin xyz="0 0 .25"/><axis xyz="0 0 -1"/><limit lower="-2" upper="2"/>
    <mimic joint="swing" multiplier="-.5" offset=".2"/></joint>
  <joint name="tip" type="fixed"><parent link="hand"/><child link="claw"/><origin xyz=".01 .02 .03"/></joint>
</robot>"""


def chains():
    made = {
        "ur10": read_urdf(shipped("ur10.urdf")).chain(),
        "panda": read_urdf(shipped("panda.urdf")).chain(),
        "odd": parse_urdf(ODD).chain(),
    }
    return {
        name: c.placed(shift(900, -300, 20) @ rpy(0.1, 1.5, 2), shift(20, 50, -80) @ rpy(1, 0.3, 0.2))
        for name, c in made.items()
    }


CHAINS = chains()


def drawn(name, n=7, seed=0):
    """Return the chain, parameters that are wrong in everything, and postures."""
    chain, rng = CHAINS[name], np.random.default_rng(seed)
    p = K.nominal(chain) + rng.normal(0, 0.05, len(K.parameter_units(chain)))
    return (
        chain,
        p,
        rng.uniform(-1.5, 1.5, (n, len(chain.driven)))
        * (100 if name == "odd" else 1) ** (np.array(chain.driven) == "rail"),
    )


def matrix(axis, angle):
    """Return a rotation about one of x y z (0 1 2), written out."""
    c, s = np.cos(angle), np.sin(angle)
    rows = {
        0: [[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0]],
        1: [[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0]],
        2: [[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0]],
    }[axis]
    return np.array([*rows, [0, 0, 0, 1]])


def moved(x, y, z):
    return np.array([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])


def written_out(chain, p, q):
    """Return the target's pose for one posture, a factor after the other; a complex step passes through."""
    value = dict(zip(K.parameter_units(chain), p, strict=True))
    stands = dict(zip(chain.driven, q, strict=True))

    def placed(of):
        x, y, z, a, b, c = (value[of.format(one)] for one in ("x", "y", "z", "rx", "ry", "rz"))
        return moved(x, y, z) @ matrix(2, c) @ matrix(1, b) @ matrix(0, a)

    at = chain.mount @ placed("base_{}")
    for joint in chain.joints:
        own = (
            stands[joint.name]
            if joint.mimic is None
            else joint.mimic.gain * stands[joint.mimic.joint] + joint.mimic.offset
        )
        s = value[f"gain_{joint.name}"] * (own + value[f"zero_{joint.name}"])
        at = at @ joint.origin @ placed("{}_" + joint.name)
        if joint.kind == "sliding":
            at = at @ moved(*(s * joint.axis))
        else:  # Euler and Rodrigues: 1 + sin(s) K + (1 - cos(s)) K^2
            x, y, z = joint.axis
            k = np.array([[0, -z, y, 0], [z, 0, -x, 0], [-y, x, 0, 0], [0, 0, 0, 0]])
            at = at @ (np.eye(4) + np.sin(s) * k + (1 - np.cos(s)) * k @ k)
    return at @ chain.tail @ chain.tool @ placed("tool_{}")


@pytest.mark.parametrize("name", CHAINS)
def test_forward_kinematics_is_the_product_written_out(name):
    chain, p, q = drawn(name)
    wanted = np.array([written_out(chain, p, one) for one in q])
    assert K.forward(chain, p, q) == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("name", CHAINS)
def test_the_jacobian_is_the_complex_step(name):
    chain, p, q = drawn(name)
    exact, turned = K.jacobian(chain, p, q), K.forward(chain, p, q)[:, :3, :3]
    for k in range(len(p)):
        z = p.astype(complex)
        z[k] += 1e-30j
        slope = np.array([written_out(chain, z, one) for one in q]).imag / 1e-30
        w = slope[:, :3, :3] @ turned.transpose(0, 2, 1)
        assert exact[:, :3, k] == pytest.approx(slope[:, :3, 3], abs=1e-9)
        assert exact[:, 3:, k] == pytest.approx(np.stack([w[:, 2, 1], w[:, 0, 2], w[:, 1, 0]], 1), abs=1e-11)


@pytest.mark.parametrize("name", ["ur10", "panda"])
def test_pinocchio_brings_the_tip_to_the_same_place(name):
    pinocchio = pytest.importorskip("pinocchio", reason="Pinocchio (pip install pin) is no dependency, only an oracle")
    chain = CHAINS[name].placed(np.eye(4), np.eye(4))
    model = pinocchio.buildModelFromUrdf(str(shipped(f"{name}.urdf")))
    data, frame = model.createData(), model.getFrameId(chain.tip)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (20, model.nq))
    order = [model.joints[model.getJointId(joint)].idx_q for joint in chain.driven]
    for one, ours in zip(q, K.forward(chain, {}, q[:, order]), strict=True):
        pinocchio.framesForwardKinematics(model, data, one)
        theirs = data.oMf[frame]
        assert ours[:3, 3] == pytest.approx(1000 * theirs.translation, abs=1e-9)
        assert ours[:3, :3] == pytest.approx(theirs.rotation, abs=1e-12)


def kinds(chain, p, q):
    """Return every kind of reading, of an arm that is a little elsewhere."""
    seen = K.forward(chain, p + np.random.default_rng(9).normal(0, 0.02, len(p)), q)
    socket = np.repeat([0, 1], len(q) // 2)
    return {
        "position": R.targets(q, seen[:, :3, 3]),
        "pose": R.targets(q, seen[:, :3, 3], seen[:, :3, :3]),
        "sockets": R.sockets(q, socket, ((0, 1, 50.0),), 2.0, 0.1 * seen[:, :3, 3]),
    }


def rows_written_out(readings, seen):
    """Return the residuals of one kind from the targets' poses, (n, 4, 4)."""
    place, rows = seen[:, :3, 3], []
    seated = readings.groups[readings.groups[:, 0] == R.SOCKET]
    means = {s: place[seated[seated[:, 2] == s, 1]].mean(axis=0) for s in seated[:, 2].tolist()}

    def turned_past(rotation, values):
        q = rotation @ values[3:].reshape(3, 3).T
        return 0.5 * np.array([q[2, 1] - q[1, 2], q[0, 2] - q[2, 0], q[1, 0] - q[0, 1]])

    for (which, a, b, _), v, w in zip(readings.groups, readings.values, readings.weight, strict=True):
        if which in (R.POSITION, R.POSE):
            rows.append(w[0] * (place[a] - v[:3]))
        if which == R.POSE:
            rows.append(w[1] * turned_past(seen[a, :3, :3], v))
        if which == R.SOCKET:
            rows.append(w[0] * (place[a] - means[b] - v[:3]))
        if which == R.GAP:
            rows.append(w[:1] * (np.linalg.norm(means[b] - means[a]) - v[0]))
    return np.concatenate(rows)


@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("kind", ["position", "pose", "sockets"])
def test_kernels_are_what_is_compared_written_out_and_their_slopes_its_differences(name, kind):
    from calibench.calibration import _kernels as kernels

    chain, p, q = drawn(name, 10)
    readings = kinds(chain, p, q)[kind]
    template, x = K.nominal(chain), p
    free = np.arange(len(template))
    plainly = rows_written_out(readings, K.forward(chain, p, q))
    for limit in (np.inf, 40.0):
        c = constants(chain, readings, template, free, limit)
        r = kernels.residuals(x, *c)
        if limit == np.inf:
            assert r == pytest.approx(plainly, abs=1e-8)
        else:  # a group of length s counts as 40 sqrt(log(1 + s^2 / 40^2)), in its own direction
            for start, size in zip(
                readings.groups[:, 3], np.diff([*readings.groups[:, 3], readings.size]), strict=True
            ):
                s = np.linalg.norm(plainly[start : start + size])
                wanted = plainly[start : start + size] * 40 * math.sqrt(math.log1p((s / 40) ** 2)) / s
                assert r[start : start + size] == pytest.approx(wanted, abs=1e-8)
        steps = 1e-6 * np.eye(len(x))
        slopes = np.stack([(kernels.residuals(x + h, *c) - kernels.residuals(x - h, *c)) / 2e-6 for h in steps], 1)
        assert kernels.jacobian(x, *c) == pytest.approx(slopes, abs=2e-6 * np.abs(slopes).max())


@pytest.mark.parametrize("kind", ["position", "pose", "sockets"])
def test_candidates_in_the_lanes_have_the_bits_of_one_alone(kind):
    from calibench.calibration import _kernels as kernels

    chain, p, q = drawn("odd", 10)
    readings, template = kinds(chain, p, q)[kind], K.nominal(chain)
    c = constants(chain, readings, template, np.arange(len(template)), 40.0)
    many = template + np.random.default_rng(3).normal(0, 0.05, (71, len(template)))
    alone = np.array([kernels.cost(x, *c) for x in many])
    assert kernels.batch(many, *c).tobytes() == alone.tobytes()
    assert alone == pytest.approx([float(r @ r) for r in (kernels.residuals(x, *c) for x in many)], rel=1e-12)


@pytest.mark.parametrize(("form", "beta"), [("standard", 0.0), ("standard", 0.1), ("modified", 0.0), ("modified", 0.1)])
def test_a_table_of_denavit_and_hartenberg_is_its_product(form, beta):
    rows = [
        {"theta": 0.1, "d": 300.0, "a": 20.0, "alpha": 1.5},
        {"theta": -0.4, "a": 400.0, "alpha": 0.01, "beta": beta},
        {"d": 100.0, "a": 5.0, "alpha": -1.4, "kind": "sliding", "name": "ram"},
    ]
    named = [{"name": f"joint_{k}", **row} for k, row in enumerate(rows, 1)]
    table = DhTable(tuple(DhRow(**row) for row in named), form)
    chain, q = table.chain, np.array([0.7, -1.2, 33.0])
    at = np.eye(4)
    for row, own in zip(rows, q, strict=True):
        slides = row.get("kind") == "sliding"
        theta, d = row.get("theta", 0.0) + (0 if slides else own), row.get("d", 0.0) + (own if slides else 0)
        about = matrix(2, theta) @ moved(0, 0, d)
        lean = matrix(1, row.get("beta", 0.0))
        if form == "standard":
            at = at @ about @ moved(row["a"], 0, 0) @ matrix(0, row["alpha"]) @ lean
        else:
            at = at @ matrix(0, row["alpha"]) @ lean @ moved(row["a"], 0, 0) @ about
    assert chain.driven == ("joint_1", "joint_2", "ram")
    assert K.forward(chain, {}, q)[0] == pytest.approx(at, abs=1e-10)


@pytest.mark.parametrize(
    ("name", "kind", "count"),
    [
        ("ur10", "pose", 30),
        ("ur10", "position", 27),
        ("panda", "pose", 34),
        ("panda", "position", 31),
    ],
)
def test_as_many_parameters_are_kept_as_the_textbook_counts(name, kind, count):
    """Everett, Driels and Mooring: 4 R + 2 P + 6; three fewer without turns."""
    chain = CHAINS[name]
    q = np.random.default_rng(4).uniform(-2, 2, (200, len(chain.driven)))
    seen = K.forward(chain, {}, q)
    kept = gauge(chain, R.targets(q, seen[:, :3, 3], seen[:, :3, :3] if kind == "pose" else None))
    assert len(kept) == count
    free = [tuple(K.parameter_units(chain)).index(n) for n in kept]
    slopes = np.concatenate(K.jacobian(chain, {}, q)[:, : 3 if kind == "position" else 6, free])
    assert np.linalg.matrix_rank(slopes / np.linalg.norm(slopes, axis=0), 1e-6) == count


def test_where_axes_are_parallel_hayatis_tilt_is_kept_and_the_shift_along_them_held():
    chain = CHAINS["ur10"]
    q = np.random.default_rng(4).uniform(-2, 2, (200, 6))
    seen = K.forward(chain, {}, q)
    kept = set(gauge(chain, R.targets(q, seen[:, :3, 3], seen[:, :3, :3])))
    for joint in ("elbow_joint", "wrist_1_joint"):  # parallel to the one before
        assert {f"rx_{joint}", f"ry_{joint}"} <= kept
        assert not {f"z_{joint}", f"y_{joint}", f"rz_{joint}"} & kept
    assert "ry_wrist_2_joint" not in kept  # at a right angle to it


def test_observability_indices_are_their_definitions():
    j = np.random.default_rng(5).normal(size=(40, 6))
    s = np.sqrt(np.linalg.eigvalsh(j.T @ j))[::-1]
    found = observability(j)
    assert found["O1"] == pytest.approx(np.prod(s) ** (1 / 6) / math.sqrt(40))
    assert found["O2"] == pytest.approx(s[-1] / s[0])
    assert found["O3"] == pytest.approx(s[-1])
    assert found["O4"] == pytest.approx(s[-1] ** 2 / s[0])
    assert found["O5"] == pytest.approx(1 / np.sum(1 / s))
    assert set(observability(j[:4]).values()) == {0.0}


def test_angles_come_back_from_a_rotation():
    for roll, pitch, yaw in ((0.3, -0.4, 2.0), (-3.0, 1.5, -1.0), (0.0, math.pi / 2, 0.7)):
        again = rpy_of(rpy(roll, pitch, yaw))
        assert rpy(*again) == pytest.approx(rpy(roll, pitch, yaw), abs=1e-12)
    q = np.array([0.1, -0.2, 0.3, 0.9])
    turned = quaternion(*(2 * q))
    assert turned[:3, :3] @ turned[:3, :3].T == pytest.approx(np.eye(3))


@pytest.mark.parametrize("name", CHAINS)
def test_numbers_that_differ_by_row_go_the_way_of_those_that_are_alike(name):
    chain, p, q = drawn(name, 12)
    p = np.where(np.arange(len(p)) < 6, 0.0, p)
    p[13:-6:8] = 1.0
    p[-3:] = 0.0
    chain = chain.placed(np.eye(4), np.eye(4))
    named = dict(zip(K.parameter_units(chain), p, strict=True))
    named = quantities(chain) | named
    way = walk(chain, np.eye(3), named | {READING + n: q[:, k] for k, n in enumerate(chain.driven)})
    poses, whole = K.forward(chain, p, q), K.jacobian(chain, p, q)
    assert way.target == pytest.approx(poses[:, :3, 3], abs=1e-8)
    assert way.flange[0] == pytest.approx(poses[:, :3, :3], abs=1e-12)
    ours = slopes(chain, way)
    for k, one in enumerate(K.parameter_units(chain)):
        if one in ours:
            assert ours[one] == pytest.approx(whole[:, :3, k], abs=1e-7)
