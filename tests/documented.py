"""What stands in the pages and is not run as it stands: each block and command with its reason.

A block is known by its page and first line, a command by the line. tests/test_documents.py runs all else, and fails for
a block that is neither run nor here, and for an entry here that stands in no page.
"""

from __future__ import annotations

HOURS = "hours of computing; its parts have tests of their own"
CLUSTER = "needs a cluster or a service; docs/clusters.md says what was tried"
FRESH = "tests/newcomer gives it in a fresh environment"
MINUTES = "minutes; `make reproduce` gives it, and the ledger's own tests do its rows"
SUITES = "needs the package of a suite, an extra; tests/bench/test_exchange.py and the suites' tests have it"
SERIES = (
    "series that do not ship; tests/benchmarks/test_arms.py has its parts, and the tables themselves where they lie"
)
PUBLISHED = "published data that do not ship; tests/bench/test_exchange.py"

BLOCKS = {
    ("README.md", "de               5000 evaluations"): "printed by the Python above it, which is run and compared",
    ("README.md", "git clone URL calibench && python -m pip install ./calibench"): FRESH,
    ("README.md", "bench run -m problem=./mine.py:Rosenbrock"): FRESH,
    ("guide.md", "git clone URL calibench && python -m pip install ./calibench"): FRESH,
    ("answer.md", "bench run study=calibration24"): HOURS,
    (
        "arm-rates.md",
        "$ bench discover machine=arm data=demo_play",
    ): "tests/independent/test_serial.py searches such arms",
    ("arm-rates.md", "python -m tests.independent.serial_run"): HOURS,
    (
        "arm-rates.md",
        "python -m benchmarks.arms.honest",
    ): "thousands of calibrations; tests/calibration/test_choose.py has some",
    ("arm-rates.md", "python -m benchmarks.arms within"): SERIES,
    ("arm-rates.md", "python -m benchmarks.arms across"): SERIES,
    ("arm-rates.md", "python -m benchmarks.arms sockets"): SERIES,
    ("clusters.md", "#!/bin/sh"): "tests/slurm gives it to a real Slurm on one machine",
    ("clusters.md", "apiVersion: batch/v1"): CLUSTER,
    ("clusters.md", "jobs:"): CLUSTER,
    ("clusters.md", "dask scheduler"): "tests/bench/test_dask.py starts a scheduler and workers itself",
    ("clusters.md", "from dask_jobqueue"): CLUSTER,
    ("costly.md", "run 3f2a de on full12"): "a line of a run that lasts; tests/bench/test_progress.py has its words",
    ("discovery-statistics.md", "python -m benchmarks.arms nested"): SERIES,
    ("discovery-statistics.md", "python -m benchmarks.blind.write"): HOURS,
    ("discovery-statistics.md", "python -m tests.independent.mount_delta_run"): HOURS,
    ("discovery-statistics.md", "python -m tests.foreign.run"): HOURS,
    ("discover.md", "demo_backlash (gpm2002)"): "what the command above it prints; tests/test_tutorials.py gives it",
    ("exchange.md", "python -m cocopp"): SUITES,
    ("exchange.md", "import iohinspector"): SUITES,
    ("field.md", "bench run study=field"): HOURS,
    ("fmincon.md", "from itertools import product"): HOURS,
    (
        "hand-eye.md",
        "bench calibrate hand_eye=eye_in_hand data=robot.csv",
    ): "tests/bench/test_hand_eye.py makes two streams",
    (
        "hand-eye.md",
        "bench calibrate hand_eye=eye_in_hand urdf=my.urdf",
    ): "tests/bench/test_calibrate_camera.py makes an arm with a camera",
    ("orthoglide-experiments.md", "bench paper"): MINUTES,
    ("orthoglide-rates.md", "python -m tests.discrepancy.orthoglide_score"): HOURS,
    ("my-robot.md", "ros2 topic echo"): "needs ROS; tests/bench/test_by_time.py makes such files",
    ("my-robot.md", "my_plate/front_left"): "a list of files; tests/bench/test_calibrate.py makes such a folder",
    ("own-machine.md", "[project.entry-points"): "tests/test_tutorials.py installs it",
    ("own-problem.md", "[project.entry-points"): "tests/core/test_names_and_options.py has entry points of its own",
    (
        "own-problem.md",
        "bench: 80 of 80 finished runs",
    ): "tests/bench/test_own_study.py makes those rows and has the words",
    ("own-problem.md", "problem        optimizer"): "what the command above it prints",
    ("own-problem.md", "@pytest.mark.parametrize"): "tests/testing holds what ships to the same checks",
    ("peers-measured.md", "python -m benchmarks peers --only"): "environments of others, and minutes",
    ("tracking.md", "$ bench studies"): "ids and studies of the reader's; tests/bench/test_studies.py gives such",
    ("tracking.md", "$ bench sql"): "a study of the reader's; tests/bench/test_studies.py gives such",
    ("tracking.md", "name: no slower method"): CLUSTER,
    ("tracking.md", "$ pip install 'calibench[ui]'"): "an installation, and a server; tests/bench/test_ui.py asks it",
    ("thresholds.md", "python -m benchmarks thresholds"): HOURS,
    ("suites.md", "pip install 'calibench[bbob,ioh]'"): "an installation",
    ("sweeps.md", "description: Two methods"): "the study of the command below it, which is given with one like it",
}

OF_A_SIMULATOR = "a program of the reader's; tests/discrepancy/test_simulator.py asks such"
COMMANDS = {
    (
        "bench discover machine=simulator machine.command='./sim {args}' machine.inputs=u,v "
        "machine.measured=y machine.sigma=0.01 'machine.parameters={\"k\":[1,0.5,2]}' "
        "data=run.csv"
    ): OF_A_SIMULATOR,
    (
        "bench discover machine=simulator machine.fmu=Arm.fmu machine.inputs=u,v "
        "machine.measured=y machine.sigma=0.01 'machine.parameters={\"k\":[1,0.5,2]}' "
        "data=run.csv"
    ): OF_A_SIMULATOR,
    "bench discover machine=simulator machine.call=arm.py:step machine.rows=one data=run.csv": OF_A_SIMULATOR,
    "bench run problem=arm problem.urdf=my.urdf problem.data=my.csv optimizer=lm budget=2000 seeds=1": (
        "files of the reader's"
    ),
    "bench calibrate urdf=my_arm.urdf data=my_poses.csv": "the tutorial on one's robot makes both files and gives it",
    "bench paper --budget ci results=results": MINUTES,
    "bench export coco results/bbob --to out/coco": SUITES,
    "bench export coco results/bbob --to out": SUITES,
    "bench import coco BIPOP-CMA-ES --to results/bipop": PUBLISHED,
    "bench import ioh their_data --to results/theirs": PUBLISHED,
    "bench export mlflow results/adhoc --to out/mlruns": "needs MLflow, an extra; tests/bench/test_exchange.py",
    "bench discover machine=gpm2002 data=run7.parquet": "a file of the reader's",
    "bench discover machine=gpm2002 data=day1.csv 'across=[day2.csv,day3.csv]'": (
        "files of the reader's; tests/bench/test_discover_across.py has such"
    ),
    (
        "bench discover machine=gpm2002 data=run7.csv "
        """columns='{"enc_1":"Winkel 1","enc_2":"Winkel 2"}' units=enc_1:deg,enc_2:deg"""
    ): "a file of the reader's; the Python below it reads one like it",
    "bench discover machine=gpm2002 data='runs/*.csv' sigma_enc=5e-5 execution=processes": "files of the reader's",
}
