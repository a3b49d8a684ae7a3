"""Arms from URDFs: the simulators are what they say and share nothing; the search finds what is hidden in them."""

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench.calibration.rigid import rotation_of
from calibench.calibration.urdf import parse_urdf
from calibench.calibration.walk import READING, walk
from calibench.discrepancy import DataError, MeasuredData, explain
from calibench.discrepancy.machines.arm import Arm
from calibench.discrepancy.machines.arm.formulation import AIM, TURNED, loads_in
from calibench.discrepancy.model.machine import complex_step_slopes
from calibench.discrepancy.model.model import Model
from tests.few import few
from tests.independent.serial import MAKES, Built, spent
from tests.independent.serial_cases import case
from tests.independent.serial_placements import fitted
from tests.independent.serial_run import told
from tests.independent.serial_score import BATCHES, alone, in_a_set, names_of, score
from tests.independent.serial_waves import told as wave_told

pytestmark = pytest.mark.usefixtures("at_one_noise")

ROOM = Path(__file__).parent


def table(make: str = "six") -> Built:
    """Return the arm of the maker's table, in the tracker's frame."""
    arm = MAKES[make]
    return Built(arm, np.zeros((len(arm.joints), 6)), np.eye(4), np.zeros(3))


@pytest.fixture
def urdf(tmp_path):
    """Return a function that writes a make's URDF and returns the machine."""

    def written(make: str = "six") -> Arm:
        path = tmp_path / f"{make}.urdf"
        path.write_text(MAKES[make].urdf())
        return Arm(str(path))

    return written


def seen(poses: int = 40, make: str = "six", seed: int = 3, sigma: float = 0.02) -> tuple[dict, Built, np.ndarray]:
    """Return columns of an arm off its table, the arm, and where its reflector truly is."""
    rng = np.random.default_rng(seed)
    arm = Built.drawn(MAKES[make], rng)
    day = spent(arm.make, rng, poses)
    first = np.flatnonzero(np.diff(day.pose, prepend=-1))
    angle = day.angle[first]
    at = arm.place(angle)
    told_at = at + sigma * rng.normal(size=at.shape)
    columns = dict(zip(arm.make.joints, angle.T)) | {name: told_at[:, k] for k, name in enumerate("xyz")}
    return columns, arm, at


def test_the_simulators_import_only_numpy_and_themselves() -> None:
    for name in ("serial", "serial_faults", "serial_cases"):
        for node in ast.walk(ast.parse((ROOM / f"{name}.py").read_text())):
            if isinstance(node, ast.Import | ast.ImportFrom):
                modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
                for module in modules:
                    own = module.startswith(("tests.independent.arm6", "tests.independent.serial"))
                    plain = module.split(".")[0] in (
                        "numpy",
                        "dataclasses",
                        "collections",
                        "copy",
                        "typing",
                        "__future__",
                    )
                    assert own or plain, f"{name}: {module}"


@pytest.mark.parametrize("make", MAKES)
def test_both_kinematics_are_one_arm(make: str) -> None:
    rng = np.random.default_rng(1)
    arm = Built.drawn(MAKES[make], rng)
    angle = rng.uniform(arm.make.low, arm.make.high, (9, len(arm.make.joints)))
    q: dict = {READING + name: angle[:, k] for k, name in enumerate(arm.make.joints)}
    for k, joint in enumerate(arm.make.joints):
        q |= dict(zip((f"{one}_{joint}" for one in ("x", "y", "z", "rx", "ry", "rz")), arm.off[k])) | {
            f"zero_{joint}": 0.0
        }
    q |= dict(zip(("base_x", "base_y", "base_z"), arm.foot[:3, 3])) | dict.fromkeys(
        ("base_rx", "base_ry", "base_rz"), 0.0
    )
    q |= dict(zip(("tool_x", "tool_y", "tool_z"), arm.tool))
    chain = parse_urdf(arm.make.urdf()).chain()
    assert np.allclose(walk(chain, arm.foot[:3, :3], q).target, arm.place(angle), atol=1e-9)


def test_slopes_are_those_of_a_complex_step(urdf) -> None:
    columns, _, _ = seen(12)
    formulation = urdf().formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02}))
    model = Model(formulation)
    q = model.quantities(model.start + 1e-3)[0]
    stepped, given = complex_step_slopes(formulation, q), formulation.slopes(q)
    assert all(np.allclose(given[name], stepped[name], atol=1e-9) for name in q)


@pytest.mark.parametrize("make", MAKES)
def test_gravity_is_that_of_the_simulator(urdf, make: str) -> None:
    rng = np.random.default_rng(2)
    arm = table(make)
    angle = rng.uniform(arm.make.low, arm.make.high, (30, len(arm.make.joints)))
    payload = rng.choice([0.0, 5.0], 30)
    columns = dict(zip(arm.make.joints, angle.T)) | {name: arm.place(angle)[:, k] for k, name in enumerate("xyz")}
    formulation = urdf(make).formulate(MeasuredData(columns | {"payload_kg": payload}, "arm", {"sigma_mm": 0.02}))
    _, held = loads_in(formulation, formulation.data)
    assert np.allclose(held, -1000 * arm.moments(angle, payload)[1:], atol=1e-3)  # but of the first row


def light(make: str, folder: Path) -> Arm:
    """Return the machine of a make whose URDF tells no masses."""
    path = folder / f"light_{make}.urdf"
    path.write_text(re.sub(r"<inertial>.*?</inertial>", "", MAKES[make].urdf(), flags=re.DOTALL))
    return Arm(str(path))


@pytest.mark.parametrize("make", few(1, MAKES))
def test_links_of_which_no_mass_is_told_are_rods_and_said_to_be(urdf, tmp_path, make: str) -> None:
    columns, _, _ = seen(40, make)
    formulation = light(make, tmp_path).formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02}))
    assert any("rod of 10 kg a metre" in note.text for note in formulation.data.notes)
    heavy = urdf(make).formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02})).data
    for joint in MAKES[make].joints[1:4]:
        torques = [data[f"torque_{joint}"] for data in (formulation.data, heavy)]
        assert np.corrcoef(*torques)[0, 1] > 0.9, joint


def test_compliance_is_named_where_no_mass_is_told(tmp_path) -> None:
    columns, arm, at = seen(120)
    angle = np.stack([columns[name] for name in arm.make.joints], axis=-1)
    elbow = list(arm.make.joints).index("elbow")
    moment = arm.moments(angle, np.zeros(len(at)))[:, elbow, 2]
    given_way = angle.copy()
    given_way[:, elbow] += 3e-4 * moment / np.abs(moment).max()
    columns |= {name: columns[name] + (arm.place(given_way) - at)[:, k] for k, name in enumerate("xyz")}
    report = explain(light("six", tmp_path), MeasuredData(columns, "arm", {"sigma_mm": 0.02}))
    assert [(one.family, one.target) for one in report.findings[0].set] == [("compliance", "elbow")]


def test_what_the_joints_hold_is_kept_for_other_readings_and_not_for_other_joints(urdf) -> None:
    columns, _, _ = seen(12)
    formulation = urdf().formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02}))
    data = formulation.data
    _, held = loads_in(formulation, data)
    assert loads_in(formulation, data.with_columns({"x": data["x"] + 1.0}))[1] is held
    turned = data.with_columns({name: data[name] + 0.5 for name in data.columns if name.startswith(READING)})
    assert not np.allclose(loads_in(formulation, turned)[1], held)
    heavier = data.with_columns({"payload_kg": np.full(len(data), 3.0)})
    assert not np.allclose(loads_in(formulation, heavier)[1], held)


def test_a_way_is_not_taken_for_that_of_other_numbers(urdf) -> None:
    columns, _, _ = seen(12)
    formulation = urdf().formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02}))
    model = Model(formulation)
    q = model.quantities(model.start)[0]
    formulation.slopes(q)
    joint = next(name for name in q if name.startswith(READING))
    q[joint] = np.asarray(q[joint]) + 0.1  # the same dictionary
    assert np.array_equal(formulation.constraints(q), formulation.constraints(dict(q)))


@pytest.mark.parametrize("make", few(1, MAKES))
@pytest.mark.parametrize("poses", [60, 300])
def test_placements_are_found_without_a_guess(urdf, make: str, poses: int) -> None:
    columns, _, at = seen(poses, make, seed=poses)
    stated = {"sigma_mm": 0.02}
    formulation = urdf(make).formulate(MeasuredData(columns, "arm", stated))
    x, wide = fitted(formulation)
    exact = formulation.on(formulation.data.with_columns({name: at[1:, k] for k, name in enumerate("xyz")}))
    true, _ = fitted(exact)
    assert np.max(np.abs(Model(exact).residuals(true))) < 2e-3  # what is held by rank moves nothing by more
    z = (x - true) / (0.02 * wide)
    assert np.mean(np.abs(z) < 3) >= 0.95
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.5


def test_a_measured_turn_is_used(urdf) -> None:
    columns, arm, _ = seen(30, sigma=0.0)
    angle = np.stack([columns[name] for name in arm.make.joints], axis=-1)
    held = rotation_of(np.array([[0.7, -0.4, 1.2]]))[0]
    R = arm.frames(angle)[-1][:, :3, :3] @ held
    turned = {
        "ry": np.arcsin(R[:, 0, 2]),
        "rx": np.arctan2(-R[:, 1, 2], R[:, 2, 2]),
        "rz": np.arctan2(-R[:, 0, 1], R[:, 0, 0]),
    }
    stated = {"sigma_mm": 0.02, "sigma_mrad": 0.05, "rotation": "xyz"}
    formulation = urdf().formulate(MeasuredData(columns | turned, "arm", stated))
    assert tuple(formulation.measured) == ("x", "y", "z", *TURNED)
    x, _ = fitted(formulation)
    assert np.max(np.abs(Model(formulation).residuals(x))) < 5e-3
    q = Model(formulation).quantities(x + 1e-4)[0]
    stepped, given = complex_step_slopes(formulation, q), formulation.slopes(q)
    assert {*TURNED, *AIM} < set(given)
    for name, slope in stepped.items():
        assert np.allclose(given[name], slope, atol=1e-6 * np.abs(slope).max()), name


@pytest.mark.slow
def test_a_ball_in_sockets_needs_no_tracker(urdf) -> None:
    arm = Built(MAKES["seven"], np.random.default_rng(4).normal(0, 5e-4, (7, 6)), np.eye(4), np.zeros(3))
    rng = np.random.default_rng(5)
    rows: dict = {name: [] for name in (*arm.make.joints, "place", "socket")}
    for place in range(4):
        middle = arm.place(rng.uniform(arm.make.low, arm.make.high, (1, 7)) * 0.5)[0]
        for socket in (0, 1):
            for _ in range(14):
                angle = reached(arm, middle + np.array([50.0 * socket, 0.0, 0.0]), rng)
                for name, value in zip(arm.make.joints, angle):
                    rows[name].append(value)
                rows["place"].append(place)
                rows["socket"].append(socket)
    data = MeasuredData(
        {name: np.array(v) for name, v in rows.items()}, "arm", {"socket_distance_mm": 50.0, "sigma_mm": 0.02}
    )
    formulation = urdf("seven").formulate(data)
    before = np.abs(Model(formulation).residuals(Model(formulation).start)).max()
    x, _ = fitted(formulation)
    assert np.abs(Model(formulation).residuals(x)).max() < 0.02 * before


def reached(arm: Built, point: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return joint angles of chance that bring the reflector to a point."""
    for _ in range(50):
        angle = rng.uniform(arm.make.low, arm.make.high) * 0.7
        for _ in range(60):
            off = point - arm.place(angle[None])[0]
            step = 1e-6
            J = (arm.place(angle + step * np.eye(7)) - arm.place(np.tile(angle, (7, 1)))).T / step
            angle = angle + np.clip(np.linalg.pinv(J, rcond=1e-3) @ off, -0.3, 0.3)
            if np.linalg.norm(off) < 1e-9:
                return angle
    raise AssertionError("not reached")


def test_wild_readings_are_left_out_and_told(urdf) -> None:
    columns, _, _ = seen(60)
    columns["y"] = columns["y"].copy()
    columns["y"][7] += 30.0
    formulation = urdf().formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02}))
    assert len(formulation.data) == 58  # nor is the first, as nothing tells from where its joints came
    assert "1 wild reading is left out" in formulation.data.notes[-1].text


def test_the_order_of_rows_tells_directions_and_says_so(urdf) -> None:
    columns, _, _ = seen(20)
    data = urdf().formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02})).data
    assert np.array_equal(data["direction_pan"], np.sign(np.diff(columns["pan"])))
    assert any("the order of rows tells it" in note.text for note in data.notes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pan": None}, "joint pan of the URDF has no column"),
        ({"pan": lambda v: np.degrees(v)}, "units=pan:deg"),
        ({"z": lambda v: -v}, "left-handed frame only"),
        ({"x": None}, "a search needs x, y and z in each row"),
        ({"lift": lambda v: v + np.pi / 2}, "-90° are added to joint lift"),
        (dict.fromkeys("xyz", lambda v: v / 1000), "units=x:m,y:m,z:m"),
    ],
)
def test_a_wrong_file_is_told_in_one_line(urdf, change: dict, words: str) -> None:
    columns, _, _ = seen(40)
    for name, how in change.items():
        if how is None:
            del columns[name]
        else:
            columns[name] = how(columns[name])
    with pytest.raises(DataError, match=words) as error:
        urdf().formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02}))
    assert "\n" not in str(error.value)


def test_three_poses_are_too_few(urdf) -> None:
    columns, _, _ = seen(3)
    with pytest.raises(DataError, match="3 poses are too few"):
        urdf().formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02}))


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (["qw", "qx", "qy", "qz"], "are read as quaternion whose first number is the real part"),
        (["qx", "qy", "qw", "qz"], "fit in no order of rotations"),
    ],
)
def test_a_quaternion_in_another_order_is_read_or_left_out_with_a_note(urdf, order: list, words: str) -> None:
    columns, turned = turned_rows()
    columns |= {name: turned[other] for name, other in zip(turned, order)}
    data = urdf().formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02})).data
    assert any(words in note.text for note in data.notes)
    assert data.has(*TURNED) == (order[0] == "qw")


def test_quaternions_of_zeros_are_no_rotations(urdf) -> None:
    columns, turned = turned_rows()
    columns |= {name: 0 * numbers for name, numbers in turned.items()}
    with pytest.raises(DataError, match="all 0 in 40 of 40 rows"):
        urdf().formulate(MeasuredData(columns, "arm", {"sigma_mm": 0.02}))


def turned_rows() -> tuple[dict, dict]:
    columns, arm, _ = seen(40)
    R = arm.frames(np.stack([columns[name] for name in arm.make.joints], axis=-1))[-1][:, :3, :3]
    return columns, dict(zip(("qx", "qy", "qz", "qw"), Rotation.from_matrix(R).as_quat().T))


def test_an_arm_needs_its_urdf() -> None:
    columns, _, _ = seen(5)
    with pytest.raises(DataError, match=r"machine\.urdf=my\.urdf"):
        Arm().formulate(MeasuredData(columns, "arm"))


def test_no_batch_shares_a_seed_with_another() -> None:
    seeds = [seed for batch in json.loads(BATCHES.read_text()) for seed in range(batch["first"], batch["last"] + 1)]
    assert len(seeds) == len(set(seeds))


LONG = ("bending", "base_drift", "tool_slip")


@pytest.mark.parametrize(
    "family", ["play", *(pytest.param(family, marks=pytest.mark.slow) for family in ("compliance", *LONG))]
)
def test_a_fault_of_visible_size_two_is_found(family: str) -> None:
    found = told(7, family=family, visible=2.0, poses=60)
    assert found.faults[0].visible > 1  # the largest that anybody would believe may be less than asked
    assert in_a_set(found.faults[0], found)
    assert alone(found)


@pytest.mark.parametrize("make", few(1, MAKES))
def test_an_arm_without_faults_lacks_nothing(make: str) -> None:
    assert told(21, kind="none", poses=60, make=make).verdict == "none"


@pytest.mark.slow
@pytest.mark.parametrize("family", ["play", "drift", "base_shift"])
def test_shuffled_poses_lose_what_follows_their_order(urdf, family: str) -> None:
    drawn = case(12, family=family, visible=3.0, poses=60, make="six")
    columns = {name: np.asarray(c) for name, c in drawn.columns.items() if name != "t_s" and "direction" not in name}
    order = np.random.default_rng(0).permutation(len(columns["x"]))
    lost = {name: c[order] for name, c in columns.items()}
    found, after = (
        {(rival.family, rival.target) for f in explain(urdf(), data).findings for rival in f.set}
        for data in (MeasuredData(one, "arm", drawn.stated, "poses") for one in (columns, lost))
    )
    assert found & names_of(drawn.faults[0])
    assert not {name for name, _ in after} & {"backlash", "drift", "slip", "base_drift", "base_shift", "tool_shift"}


@pytest.mark.slow
def test_the_bars_hold_on_kept_seeds() -> None:
    rates = {one.what: one for one in score([told(seed) for seed in range(42000, 42300)])}
    assert rates["in its set, one fault, visible >= 1"].interval[1] >= 0.95
    assert rates["alone and right, one fault, visible >= 1"].interval[1] >= 0.85
    assert rates["silent where nothing is missing"].interval[1] >= 0.985


@pytest.mark.slow
def test_a_wave_whose_order_nobody_states_is_named_with_its_order():
    found = wave_told("wave", 46203)
    [(target, order, visible)] = found["hidden"]
    assert visible >= 1
    assert found["found"] == [[f"periodic_error {target}"]]
    assert found["orders"] == pytest.approx([order], abs=0.1)
