"""The words of the verbs, declared: each class is what one verb reads by `bench.words.read`, and what its help says.

Nothing heavy is imported here, so that ``bench VERB --help`` answers at once. What words mean together is checked in
the room that carries the verb out. `bench run` is composed by Hydra: its words are in ``conf/``.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, final

from calibench.bench.words import Word
from calibench.core.options import LARGEST_WHOLE

MOST_RESAMPLES, MOST_POSES, MOST_TRIALS = 10_000, 200, 10_000
LARGEST_SIZE = 1e6  # sigma: beyond it, and below its inverse, squares lose their digits

# fmt: off
DH = "table of Denavit and Hartenberg, CSV or Excel, in place of a URDF"
CONVENTION = "the convention of that table; modified is Craig's"
Base = Annotated[str, Word("machine.base", "base_link", "the link of the URDF where the arm begins", form="LINK")]
Tip = Annotated[str, Word("machine.tip", "tool0", "the link of the URDF where it ends, such as tool0", form="LINK")]
Columns = Annotated[str, Word(
    "columns", '{"x":"Weg X"}', "which column of the file is which, where the names are others",
    form='\'{"x":"Weg X"}\'')]
Units = Annotated[str, Word("units", "x1:mm", "the unit of columns", form="x:m,y:m")]
Rotation = Annotated[str, Word("rotation", "rpy", "how three angles make a rotation; found where it is not stated",
                               form="rpy|xyz|vector")]
Study = Annotated[str, Word("study", "NAME", "the folder inside results=")]
Results = Annotated[str, Word("results", "results", "where results go", form="DIR")]
Machine = Annotated[str, Word("machine", "arm", "the machine; `bench list machines` has them with their options",
                              form="NAME")]
Options = Annotated[dict[str, str], Word("machine.", "...", "an option of the machine", form="OPTION=V")]
OfData = Annotated[dict[str, str], Word(
    "data.", "...", "what your own machine reads of its data, where no file states it", form="KEY=V")]
Stated = Annotated[dict[str, str], Word("", "...", "what the machine reads of its data")]


@final
@dataclass(frozen=True, kw_only=True)
class CalibrateWords:
    """`bench calibrate`: an arm, its readings, and how much of it is calibrated."""

    urdf: Annotated[Path | None, Word("urdf", "my.urdf", "the arm's URDF", form="FILE")] = None
    dh: Annotated[Path | None, Word("dh", "my_table.csv", f"its {DH}", form="TABLE")] = None
    convention: Annotated[str, Word("convention", "standard", CONVENTION, form="standard|modified")] = ""
    data: Annotated[str, Word("data", "my.csv", "a file of joints and readings, or a folder of sockets",
                              form="FILE|GLOB|FOLDER")]
    base: Base = ""
    tip: Tip = ""
    machine: Annotated[str, Word("machine", "arm", "may be left out")] = ""
    observe: Annotated[Literal["position", "pose", "sockets"] | None, Word(
        "machine.observe", "position", "what was read; found from the columns where it is not stated")] = None
    hand_eye: Annotated[Literal["eye_in_hand", "eye_to_hand"] | None, Word(
        "hand_eye", "eye_in_hand", "a camera read a board's pose; arm and camera are calibrated in one fit")] = None
    read: Annotated[Literal["board_in_camera", "camera_in_board"] | None, Word(
        "read", "board_in_camera", "hand_eye: what the camera's columns hold")] = None
    board_scale: Annotated[float | None, Word(
        "board_scale", "0.97", "hand_eye: true size of the board by the stated one", form="RATIO", above=0)] = None
    columns: Columns = ""
    units: Units = ""
    rotation: Rotation = ""
    distance: Annotated[float | None, Word(
        "distance", "50", "sockets: how far the two of a place are apart", form="MM", least=0)] = None
    sigma_distance: Annotated[float | None, Word(
        "sigma_distance", "0.05", "sockets: how well that distance is known", form="MM", above=0)] = None
    gap: Annotated[float | None, Word(
        "gap", "0.1", "joints and poses in two files with times: how far apart rows may be", form="SECONDS",
        above=0)] = None
    priors: Annotated[str, Word(
        "priors", "my_priors.csv", "numbers that you know: a table of name, value, sd [mm, rad]", form="FILE")] = ""
    level: Annotated[Literal["auto", "frames", "zeros", "geometry", "gains", "elastic"], Word(
        "level", "geometry", "how much of the arm is calibrated")] = "auto"
    limits: Annotated[bool, Word(
        "limits", "false", "whether joints must stand inside the limits of the description")] = True
    resamples: Annotated[int, Word(
        "resamples", "200", "draws for the intervals", form="N", least=20, most=MOST_RESAMPLES)] = 200
    page: Annotated[bool, Word("page", "false", "whether report.html is written")] = True
    study: Study = "calibrate"
    results: Results = "results"


@final
@dataclass(frozen=True, kw_only=True)
class HandEyeWords:
    """`bench calibrate hand_eye=...`: pairs of poses of a flange and of a board."""

    hand_eye: Annotated[Literal["eye_in_hand", "eye_to_hand"], Word(
        "hand_eye", "eye_in_hand", "where the camera is: on the hand, or beside the robot")]
    data: Annotated[str, Word("data", "pairs.csv", "a file of poses of flange and board", form="FILE")]
    read: Annotated[Literal["board_in_camera", "camera_in_board"] | None, Word(
        "read", "board_in_camera", "what the camera's columns hold")] = None
    flange: Annotated[Literal["flange_in_base", "base_in_flange"], Word(
        "flange", "base_in_flange", "what the robot's columns hold")] = "flange_in_base"
    rotation: Rotation = ""
    columns: Annotated[str, Word("columns", '{"flange_x":"Weg X"}', "which column of the file is which",
                                 form='\'{"flange_x":"Weg X"}\'')] = ""
    units: Annotated[str, Word("units", "flange_x:m", "the unit of columns")] = ""
    board_scale: Annotated[str, Word(
        "board_scale", "0.97", "true size of the board by the stated one, or free: fitted",
        form="RATIO|free")] = "1"
    sigma: Annotated[float | None, Word(
        "sigma", "0.3", "noise of the board's place; learned where it is not stated", form="MM", above=0)] = None
    sigma_rotation: Annotated[float | None, Word(
        "sigma_rotation", "0.001", "noise of its rotation; learned where it is not stated", form="RAD", above=0)] = None
    study: Study = "hand_eye"
    results: Results = "results"


@final
@dataclass(frozen=True, kw_only=True)
class PosesWords:
    """`bench design machine=arm plan.n=N`: which poses of an arm to measure."""

    n: Annotated[int | None, Word(
        "plan.n", "20", "how many poses to propose", form="N", least=1, most=MOST_POSES)] = None
    machine: Annotated[str, Word("machine", "arm", "poses are of an arm")] = ""
    urdf: Annotated[Path | None, Word("machine.urdf", "my.urdf", "the arm's URDF", form="FILE")] = None
    dh: Annotated[Path | None, Word("machine.dh", "my_table.csv", f"the arm's {DH}", form="TABLE")] = None
    convention: Annotated[str, Word("machine.convention", "standard", CONVENTION, form="standard|modified")] = ""
    base: Base = ""
    tip: Tip = ""
    data: Annotated[str, Word("data", "my.csv", "what is measured already; poses are added to it", form="FILE")] = ""
    observe: Annotated[Literal["position", "pose"] | None, Word(
        "machine.observe", "position", "what will be read",
        needed="poses are proposed for position|pose; with a ball in sockets take as many postures as the arm can "
        "reach in each, and places far apart")] = None
    columns: Columns = ""
    units: Units = ""
    rotation: Rotation = ""
    by: Annotated[Literal["D", "E"], Word(
        "plan.by", "D", "D: care for all numbers; E: for the one that is known worst")] = "D"
    sigma: Annotated[float | None, Word(
        "plan.sigma", "0.05", "noise of the readings to come (0.05)", form="MM", above=0)] = None
    sigma_rotation: Annotated[float | None, Word(
        "plan.sigma_rotation", "0.0005", "noise of their rotations (0.0005)", form="RAD", above=0)] = None
    target: Annotated[tuple[float, float, float], Word(
        "plan.target", "[0,100,100]", "where the target sits on the last link [mm]")] = (0.0, 100.0, 100.0)
    limits: Annotated[Literal["urdf", "table", "data"] | None, Word(
        "plan.limits", "data", "which range of the joints is kept to")] = None
    box: Annotated[tuple[float, ...] | None, Word(
        "plan.box", "[300,900,-500,500,0,800]", "keep the tip inside a box of the base [mm]",
        form="[x0,x1,y0,y1,z0,z1]")] = None
    keep_out: Annotated[tuple[float, ...] | None, Word(
        "plan.keep_out", "[-800,800,-900,-400,0,700]", "keep arm and target out of boxes of the base [mm]",
        form="[x0,x1,y0,y1,z0,z1,...]")] = None
    off: Annotated[float, Word(
        "plan.off", "0.5", "what a number may be off unread [mm, mrad]", form="MM", above=0)] = 0.5
    seed: Annotated[int, Word("plan.seed", "0", "another N draws other poses to choose from", form="N")] = 0
    to: Annotated[Path | None, Word(
        "plan.to", "poses.csv", "write poses [rad, mm], joint targets, a drawing of the gain", form="FILE")] = None


@final
@dataclass(frozen=True, kw_only=True)
class DiscoverWords:
    """`bench discover`: a machine, its data, and what is stated of both."""

    machine: Machine = ""
    data: Annotated[str, Word("data", "run7.parquet", "the readings", form="FILE|GLOB|FOLDER|NAME")] = ""
    across: Annotated[str, Word(
        "across", "[day2.csv,day3.csv]", "other sets of the same machine: which findings of data= they carry",
        form="[FILE,FILE]")] = ""
    study: Study = "discover"
    results: Results = "results"
    pages: Annotated[Literal["auto", "all", "none"], Word(
        "pages", "all", "of which sets of data a page is written")] = "auto"
    execution: Annotated[Literal["serial", "processes"], Word(
        "execution", "processes", "one process, or some")] = "serial"
    n_jobs: Annotated[int | None, Word(
        "execution.n_jobs", "4", "how many processes; -1: as many as the computer has cores", form="N")] = None
    columns: Columns = ""
    units: Units = ""
    options: Options = field(default_factory=dict)
    of_data: OfData = field(default_factory=dict)
    stated: Stated = field(default_factory=dict)


@final
@dataclass(frozen=True, kw_only=True)
class DesignWords:
    """`bench design`: data or a plan of a machine, and what should be seen in it."""

    machine: Machine = ""
    data: Annotated[str, Word("data", "run7.parquet", "readings that are there", form="FILE")] = ""
    plan: Annotated[str, Word("plan", "disc", "a plan of readings in place of data=", form="NAME")] = ""
    size: Annotated[float, Word(
        "size", "1", "how large the effects are that should be seen", form="SIGMAS", least=1 / LARGEST_SIZE,
        most=LARGEST_SIZE)] = 1.0
    rivals: Annotated[str, Word("rivals", "A,B", "effects that the next readings should split")] = ""
    further: Annotated[int, Word("next", "4", "how many readings to propose", form="K", least=0, most=50)] = 4
    columns: Columns = ""
    units: Units = ""
    plan_options: Annotated[dict[str, str], Word("plan.", "...", "an option of the plan", form="OPTION=V")] = field(
        default_factory=dict)
    options: Options = field(default_factory=dict)
    of_data: OfData = field(default_factory=dict)
    stated: Stated = field(default_factory=dict)


@final
@dataclass(frozen=True, kw_only=True)
class IdentifyWords:
    """`bench identify`: a problem, and the noise of its readings."""

    problem: Annotated[str, Word(
        "problem", "full12", "`bench list problems` has them with their options", form="NAME")] = ""
    options: Annotated[dict[str, str], Word("problem.", "...", "an option of the problem", form="OPTION=V")] = field(
        default_factory=dict)
    noise: Annotated[float | None, Word(
        "noise", "1e-4", "noise of a reading [rad, or mm for the Orthoglide]", form="V")] = None


@final
@dataclass(frozen=True, kw_only=True)
class PaperWords:
    """`bench paper`: how the papers are rerun."""

    budget: Annotated[str, Word("budget", "ci", "evaluations of a run", form="ci|paper|N")] = "ci"
    results: Results = "results"
    seeds: Annotated[str, Word("seeds", "5", "repetitions; as the papers have them where not stated", form="N")] = ""
    execution: Annotated[str, Word(
        "execution", "processes", "how runs are shared out", form="serial|processes")] = "processes"
    to: Annotated[str, Word("to", "results/reference", "where a small copy of all of it is kept", form="DIR")] = ""


@final
@dataclass(frozen=True, kw_only=True)
class ChooseWords:
    """`bench choose`: of which runs the best setting is chosen, and by what."""

    optimizer: Annotated[str, Word("optimizer", "de", "one method, in place of all that were swept", form="NAME")] = ""
    by: Annotated[Literal["value", "goal"], Word("by", "value", "what is best")] = "value"
    over: Annotated[Literal["instances", "seeds"], Word(
        "over", "instances", "what is left out in turn to judge the choice")] = "instances"
    budget: Annotated[str, Word("budget", "2000", "runs of one budget", form="N")] = ""
    start: Annotated[str, Word("start", "random", "runs from one start", form="nominal|random")] = ""


@final
@dataclass(frozen=True, kw_only=True)
class CompareWords:
    """`bench compare`: by what runs are ordered."""

    by: Annotated[Literal["goal", "value", "charged"], Word("by", "goal", "what is better")] = "goal"


@final
@dataclass(frozen=True, kw_only=True)
class HistoryWords:
    """`bench history`: which runs are followed over versions of the code, and by what they are ordered."""

    problem: Annotated[str, Word("problem", "full12", "which problems; globs are read", form="NAME")]
    optimizer: Annotated[str, Word("optimizer", "de", "which methods; globs are read", form="NAME")]
    by: Annotated[Literal["goal", "charged", "value", "success"], Word("by", "goal", "what is better")] = "goal"
    start: Annotated[str, Word("start", "random", "runs from one start", form="nominal|random")] = "*"
    budget: Annotated[str, Word("budget", "2000", "runs of one budget", form="N")] = "*"
    tag: Annotated[str, Word("tag", "baseline", "--check: the study to compare with; else the last with any tag")] = ""
    to: Annotated[Path | None, Word("to", "history.html", "write the drawing as a page", form="FILE")] = None
    results: Results = "results"


@final
@dataclass(frozen=True, kw_only=True)
class TrackingWords:
    """`bench show|note|tag|archive|delete|pack|unpack`: where the studies are."""

    results: Results = "results"


@final
@dataclass(frozen=True, kw_only=True)
class UiWords:
    """`bench ui`: where it answers."""

    port: Annotated[int, Word("port", "8765", "of this machine; 0 takes a free one", least=0, most=65535)] = 8765
    results: Results = "results"


@final
@dataclass(frozen=True, kw_only=True)
class TunerWords:
    """`bench run tuner=optuna`: how options are proposed."""

    tuner: Annotated[str, Word("tuner", "optuna", "Optuna proposes values for options")] = ""
    trials: Annotated[int, Word("tuner.trials", "N", "how many settings are tried", least=1, most=MOST_TRIALS)] = 20
    sampler: Annotated[Literal["tpe", "random", "cmaes"], Word(
        "tuner.sampler", "tpe", "how the next one is chosen")] = "tpe"
    seed: Annotated[int, Word("tuner.seed", "N", "of the sampler", least=0, most=LARGEST_WHOLE)] = 0
    by: Annotated[Literal["value", "goal"], Word("tuner.by", "value", "what is best")] = "value"
