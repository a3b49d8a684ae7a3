"""This package, measured as its peers are: in a process of its own, through the same requests."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import arm6
import arms3
import numpy as np
import pairs40
from answering import ROOT, Level, answer, cost, full12, points_in, reaching, timed

if TYPE_CHECKING:
    from calibench.bench.calibration.request import CalibrateRequest

sys.path.append(str(ROOT))
_SWARM = {"variant": 1, "omega": 0.7298, "eta1": 2.0, "eta2": 2.0}
_BUDGET = 500_000
_SEEDS = iter(range(10**9))
_FILE = Path(__file__).with_name("small_runs.py")


def _count(work: Mapping[str, Any]) -> dict[str, Any]:
    problem = full12()
    return cost(problem, _gate(problem), points_in(problem))


def _count_users(work: Mapping[str, Any]) -> dict[str, Any]:
    """Count the same objective as a user's: a class in Python, of which the gate knows nothing."""
    problem = full12()

    class Users:
        lower, upper, start, truth = problem.lower, problem.upper, problem.start, problem.truth

        def __call__(self, x: Any) -> float:
            return float(problem(x))

    users = Users()
    return cost(users, _gate(users), points_in(problem))


def _count_batches(work: Mapping[str, Any]) -> dict[str, Any]:
    problem = full12()
    hundreds = np.array(points_in(problem, 10_000)).reshape(100, 100, -1)
    return cost(problem.batch, _gate(problem).batch, list(hundreds), each=100)


def _gate(problem: Any) -> Any:
    """Return what an optimiser gets, of a gate that has seen a good point, as it has in nearly all calls."""
    from calibench.bench.gate.evaluator import Evaluator
    from calibench.bench.gate.face import doors_of, face_of

    gate = Evaluator(problem, 10**15)
    gate(problem.truth)
    return face_of(gate, doors_of(gate))


def _search(name: str, options: Mapping[str, Any], budget: int, work: Mapping[str, Any]) -> dict[str, Any]:
    """Search by one of our optimisers, or by pygmo's, through the gate."""
    from calibench import optimizers
    from calibench.bench.gate.evaluator import Evaluator
    from calibench.optimizers.base import Stop

    method = optimizers.make(name, **options)
    gate = Evaluator(full12(), budget)

    def searched() -> int:
        with suppress(Stop):
            method.minimize(gate, np.random.default_rng(next(_SEEDS)))
        return gate.evaluations

    if hasattr(method, "compile"):
        method.compile()
    return timed(searched)


def _pygmo(
    algorithm: str, size: int, settings: Mapping[str, Any], work: Mapping[str, Any], batches: bool = False
) -> dict[str, Any]:
    import pygmo

    problem = full12()

    class Udp:
        def fitness(self, x: Any) -> list[float]:
            return [problem(x)]

        def batch_fitness(self, flat: Any) -> Any:
            return problem.batch(flat.reshape(-1, len(problem.lower)))

        def get_bounds(self) -> tuple[Any, Any]:
            return problem.lower, problem.upper

    named = getattr(pygmo, algorithm)(gen=15_000 // size, seed=next(_SEEDS), **settings)
    if batches:
        named.set_bfe(pygmo.bfe(pygmo.member_bfe()))
    method = pygmo.algorithm(named)

    def searched() -> int:
        population = pygmo.population(pygmo.problem(Udp()), size=size, seed=next(_SEEDS))
        return int(method.evolve(population).problem.get_fevals())

    return timed(searched)


def _nlopt(algorithm: str, work: Mapping[str, Any]) -> dict[str, Any]:
    import nlopt

    problem = full12()
    nlopt.srand(next(_SEEDS))
    search = nlopt.opt(getattr(nlopt, algorithm), len(problem.lower))
    search.set_lower_bounds(problem.lower)
    search.set_upper_bounds(problem.upper)
    search.set_min_objective(lambda x, gradient: problem(x))
    search.set_maxeval(15_000)

    def searched() -> int:
        search.optimize(np.array(problem.start))
        return int(search.get_numevals())

    return timed(searched)


def _scipy(workers: int, work: Mapping[str, Any]) -> dict[str, Any]:
    """Search by SciPy's differential evolution: whole generations at once, or its candidates in so many processes."""
    from scipy.optimize import differential_evolution

    problem, rng = full12(), np.random.default_rng(next(_SEEDS))
    bounds = list(zip(problem.lower, problem.upper, strict=True))
    first = problem.lower + rng.random((150, len(bounds))) * (problem.upper - problem.lower)
    how = {"workers": workers} if workers else {"vectorized": True}

    def searched() -> int:
        found = differential_evolution(
            problem if workers else lambda columns: problem.batch(columns.T), bounds, strategy="rand1bin", mutation=0.5,
            recombination=0.8, init=first, maxiter=100, tol=0, atol=0, polish=False, rng=rng, updating="deferred",
            **how,
        )  # fmt: skip
        return int(found.nfev) if found.nfev > 15_000 else 150 * (found.nit + 1)

    return timed(searched)


def _reach(name: str, options: Mapping[str, Any], work: Mapping[str, Any]) -> dict[str, Any]:
    """Search by one of our optimisers, or by one of a library's, through the gate."""
    from calibench import bench, optimizers

    method = optimizers.make(name, **options)

    def searched(level: Level, start: Any, seed: int) -> None:
        budget = level.most - level.count
        run = bench.execute(level.problem, method, budget=budget, seed=seed, start=start, target=level.level)
        level.seen(run.best_value, max(run.charged, 1))

    return reaching(searched)


def _reach_pygmo(algorithm: str, size: int, settings: Mapping[str, Any], work: Mapping[str, Any]) -> dict[str, Any]:
    import pygmo

    def searched(level: Level, start: Any, seed: int) -> None:
        class Udp:
            def fitness(self, x: Any) -> list[float]:
                return [level(x)]

            def get_bounds(self) -> tuple[Any, Any]:
                return level.lower, level.upper

        named = getattr(pygmo, algorithm)(gen=level.most // size, seed=seed, **settings)
        pygmo.algorithm(named).evolve(pygmo.population(pygmo.problem(Udp()), size=size, seed=seed))

    return reaching(searched)


def _reach_scipy(work: Mapping[str, Any]) -> dict[str, Any]:
    from scipy.optimize import least_squares

    def searched(level: Level, start: Any, seed: int) -> None:
        found = least_squares(level.problem.residuals, start, level.problem.jacobian, method="lm", x_scale="jac")
        level.seen(2 * found.cost, found.nfev)

    return reaching(searched)


def _reach_scipy_de(work: Mapping[str, Any]) -> dict[str, Any]:
    from scipy.optimize import differential_evolution

    def searched(level: Level, start: Any, seed: int) -> None:
        differential_evolution(
            lambda columns: level.batch(columns.T), list(zip(level.lower, level.upper, strict=True)), x0=start,
            maxiter=10**6, tol=0, atol=0, polish=False, rng=seed, vectorized=True, updating="deferred",
        )  # fmt: skip

    return reaching(searched)


def _bench(*words: str) -> None:
    from calibench.bench.cli import main

    sys.argv = ["bench", *words]
    with suppress(SystemExit):
        if code := main(list(words)):
            raise RuntimeError(f"bench {words[0]}: exit code {code}")


def _sweep(work: Mapping[str, Any]) -> dict[str, Any]:
    """Search at random a thousand times on a problem and by an optimiser of a user's own; print the table."""
    from calibench import bench

    runs, folder = work["runs"], work["folder"]
    _bench(
        "run", f"problem={_FILE}:Sphere", f"optimizer={_FILE}:Wanderer", f"budget={work['budget']}", f"seeds={runs}",
        "start=random", "study=small", f"results={folder}",
    )  # fmt: skip
    table = bench.ResultStore(Path(folder) / "small").runs()
    print(table.groupby("optimizer")["best_value"].describe())
    return {"count": len(table)}


def _plot(work: Mapping[str, Any]) -> dict[str, Any]:
    """Compare two methods on a user's own function: figures and the page."""
    methods = "optimizer=de,nlopt_LN_BOBYQA"
    words = (f"budget={work['budget']}", "seeds=5", "start=random", "study=first", f"results={work['folder']}")
    _bench("run", "-m", f"problem={_FILE}:Sphere", methods, *words)
    _bench("report", f"{work['folder']}/first")
    page = Path(work["folder"]) / "first" / "report.html"
    return {"note": f"2 methods, 5 seeds, a page of {page.stat().st_size / 1e6:.2g} MB with all its figures"}


def _report(work: Mapping[str, Any]) -> dict[str, Any]:
    """Write the page of a study of `runs` runs that has none yet."""
    study = Path(work["folder"]) / "adhoc"
    study.mkdir()
    for name in ("manifest.json", "runs.parquet", "traces.parquet"):
        shutil.copy2(Path(work["study"]) / name, study)
    _bench("report", str(study))
    page = study / "report.html"
    return {"note": f"one page, {page.stat().st_size / 1e6:.2g} MB"}


def _read(work: Mapping[str, Any]) -> dict[str, Any]:
    from calibench import bench

    return timed(lambda: len(bench.ResultStore(work["study"]).runs()))


def _calibrate(name: str, work: Mapping[str, Any]) -> dict[str, Any]:
    """Calibrate the planar robot by least squares, from the nominal parameters, through the gate."""
    from calibench import bench, optimizers, problems

    problem = problems.make("full12", **work["options"])
    problem.compile()
    method = optimizers.make(name)
    found: list[Any] = []

    def calibrated() -> int:
        found.append(bench.execute(problem, method, budget=2000, seed=0))
        return 1

    taken = timed(calibrated)
    return {
        **taken,
        "note": f"exact derivatives, {found[0].charged} charged, sum of squares left {found[0].best_value:.1g}",
    }


def _arm_files(work: Mapping[str, Any]) -> CalibrateRequest:
    """Write the arm and its poses as files, and return the request to calibrate it."""
    from calibench.bench.calibration.request import read_calibrate

    urdf, table = Path(work["folder"]) / "arm6.urdf", Path(work["folder"]) / "seen.csv"
    urdf.write_text(arm6.urdf())
    heads = ",".join([*(f"j{i} [rad]" for i in range(1, 7)), "x [m]", "y [m]", "z [m]"])
    np.savetxt(table, np.hstack(arm6.seen()), fmt="%.17g", delimiter=",", header=heads, comments="")
    return read_calibrate([f"urdf={urdf}", f"data={table}", "level=geometry"])


def _arm_fit(work: Mapping[str, Any]) -> dict[str, Any]:
    """Fit base, target and geometry to the poses; the files have been read."""
    from calibench.bench.calibration.request import read_table
    from calibench.calibration.determined import order_of
    from calibench.calibration.fit import fit_arm
    from calibench.calibration.model import model_of
    from calibench.calibration.urdf import parse_urdf

    request = _arm_files(work)
    chain = parse_urdf(request.path.read_bytes(), "arm6").chain(request.given.base, request.given.tip)
    table = read_table(request.given.data, request.stated)
    found: list[Any] = []

    def calibrated() -> int:
        start = request.how.start(table, chain)
        model = model_of(chain, start.readings, start.base, start.tool)
        found.append(fit_arm(model, order_of(model.names, "geometry")))
        return 1

    taken = timed(calibrated)
    left = np.abs(found[0].model.errors(found[0].p)[0]).max()
    return {
        **taken,
        "note": f"{len(found[0].kept)} parameters the data determine, derivatives, largest residual {left:.1g} mm",
    }


def _arm_whole(work: Mapping[str, Any]) -> dict[str, Any]:
    """Do all that `bench calibrate` does but the writing."""
    request = _arm_files(work)
    found: list[Any] = []

    def calibrated() -> int:
        found.append(request.carry_out())
        return 1

    taken = timed(calibrated)
    held_out = next(level.rms for level in found[0].levels if level.level == found[0].chosen)
    return {**taken, "note": f"24 fits and 200 draws, rms of poses that were not fitted {held_out:.1g} mm"}


def _calibrated(folder: str, name: str) -> Any:
    from calibench import calibrate
    from calibench.calibration import read_urdf
    from calibench.calibration.kinematics import forward, nominal
    from calibench.calibration.rigid import rpy, shift

    answer = calibrate(f"{folder}/{name}.urdf", _columns(folder, name), tip=_tip(folder, name))
    chain = read_urdf(answer.write_urdf(f"{folder}/{name}_calibrated.urdf")).chain("", _tip(folder, name))
    x, y, z, roll, pitch, yaw = answer.frames["base"]
    base = shift(x, y, z) @ rpy(roll, pitch, yaw)
    return lambda q: (base @ forward(chain, nominal(chain), q))[:, :3, 3] / 1e3


def _columns(folder: str, name: str) -> dict[str, Any]:
    q, seen = arms3.read(folder, name)
    return {f"j{k + 1} [rad]": q[:, k] for k in range(q.shape[1])} | {f"{a} [m]": c for a, c in zip("xyz", seen.T)}


def _tip(folder: str, name: str) -> str:
    return f"l{arms3.read(folder, name)[0].shape[1] + 1}"


def _arms(work: Mapping[str, Any]) -> dict[str, Any]:
    from calibench.calibration import read_urdf

    return arms3.measure(work["arms"], _calibrated, lambda path: read_urdf(path).chain("base", "l7"))


def _camera(flanges: Any, boards: Any) -> Any:
    from scipy.spatial.transform import Rotation

    import calibench

    names = [f"{frame}_{axis}" for frame in ("flange", "board") for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    turns = [Rotation.from_matrix(poses[:, :3, :3]).as_quat() for poses in (flanges, boards)]
    table = np.hstack([1e3 * flanges[:, :3, 3], turns[0], 1e3 * boards[:, :3, 3], turns[1]])
    units = {name: "mm" for name in names if name[-2:] in ("_x", "_y", "_z")}
    return calibench.hand_eye(dict(zip(names, table.T, strict=True)), units=units)


def _hand_eye(wild: bool, work: Mapping[str, Any]) -> dict[str, Any]:
    found, (flanges, boards) = [], pairs40.pairs(wild)

    def calibrated() -> int:
        found.append(_camera(flanges, boards))
        return 1

    taken = timed(calibrated)
    camera = np.asarray(found[0].camera.matrix, dtype=float).copy()
    camera[:3, 3] /= 1e3
    return {**taken, "note": pairs40.told(camera, _camera)}


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "counting": {
        "ours, an objective of a user's in Python": _count_users,
        "ours, its own compiled objective": _count,
        "ours, batches of 100": _count_batches,
    },
    "arms": {"ours": _arms},
    "de": {
        "ours": partial(_search, "de", {"population": 150}, _BUDGET),
        "pygmo, our dependency": partial(_pygmo, "de", 150, {"F": 0.5, "CR": 0.8, "variant": 7, "ftol": 0, "xtol": 0}),
        "SciPy, vectorised, our dependency": partial(_scipy, 0),
        "SciPy, workers=2, our dependency": partial(_scipy, 2),
        "NLopt CRS2, our dependency": partial(_nlopt, "GN_CRS2_LM"),
    },
    "pso": {
        "ours": partial(_search, "pso", {"population": 100}, _BUDGET),
        "pygmo, our dependency": partial(_pygmo, "pso", 100, _SWARM),
        "pygmo pso_gen, batches (bfe)": partial(_pygmo, "pso_gen", 100, _SWARM, batches=True),
    },
    "ga": {
        "ours": partial(_search, "ga", {"population": 100}, _BUDGET),
        "pygmo, our dependency": partial(_pygmo, "sga", 100, {}),
    },
    "cmaes": {
        "ours: pygmo's through our gate": partial(_search, "pygmo_cmaes", {"population": 100}, 15_000),
        "pygmo alone, our dependency": partial(_pygmo, "cmaes", 100, {"ftol": 0, "xtol": 0, "force_bounds": True}),
    },
    "noise_level": {
        "ours, lm": partial(_reach, "lm", {}),
        "ours, fmincon": partial(_reach, "fmincon", {}),
        "ours, de": partial(_reach, "de", {}),
        "ours: pygmo's CMA-ES through our gate": partial(_reach, "pygmo_cmaes", {"population": 100}),
        "ours: NLopt's BOBYQA through our gate": partial(_reach, "nlopt_LN_BOBYQA", {}),
        "SciPy least_squares lm, our dependency": _reach_scipy,
        "SciPy DE, vectorised, our dependency": _reach_scipy_de,
        "pygmo CMA-ES, our dependency": partial(
            _reach_pygmo, "cmaes", 100, {"ftol": 0, "xtol": 0, "force_bounds": True}
        ),
        "pygmo sade, our dependency": partial(_reach_pygmo, "sade", 100, {"ftol": 0, "xtol": 0}),
    },
    "sweep": {"ours": _sweep},
    "plot": {"ours": _plot},
    "report": {"ours": _report},
    "reading": {"ours": _read},
    "arm": {"ours, the fit": _arm_fit, "ours, `bench calibrate`": _arm_whole},
    "hand_eye": {"ours, `hand_eye`": partial(_hand_eye, False)},
    "hand_eye_wild": {"ours, `hand_eye`": partial(_hand_eye, True)},
    "calibration": {"ours, lm": partial(_calibrate, "lm"), "ours, trf": partial(_calibrate, "trf")},
}


if __name__ == "__main__":
    answer(LINES)
