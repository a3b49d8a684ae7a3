"""The command line: ``bench <verb> ...``. A verb's file is imported when it is called: `list` must answer at once.

Exit 0: done. 1: some run failed (a table of failures ends the output). 2: the request is wrong: one line that says what
and how to put it right, no traceback, nothing written.
"""

import errno
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from traceback import extract_tb

from calibench.core import process
from calibench.core.words import check_word, one_line, shortened

_USAGE = """usage: bench VERB ...            (calibench VERB ... is the same; --version)
       bench VERB --help         what one verb reads: all of its words, with what they mean

  list problems|optimizers|effects|machines|studies|figures [NAME ...] [--all] [--json]
                                                       what there is, with traits and options; FILE.py:CLASS is
                                                       yours; --all: and what is left out, with the reason
  run [-m] problem=NAME optimizer=NAME [OPTION=V]      a row a run; -m sweeps lists: problem=full11,full12
  run study=quick|cong2008 [OPTION=V]                  a prepared study
  run tuner=optuna [OPTION=V]                          Optuna proposes 'optimizer.population=int(interval(10,200))'
  identify problem=NAME [OPTION=V] [--json]            what the data of a problem can tell at all
  paper [OPTION=V]                                     rerun the papers: printed | ours | verdict | why
  discover machine=NAME data=FILE|GLOB|FOLDER|NAME [OPTION=V] [--json] [--retry]
                                                       what the model is missing: where, which effect, how large;
                                                       OPTION: what a file should state and does not (sigma_enc=5e-5)
  calibrate urdf=FILE|dh=TABLE data=FILE|GLOB|FOLDER [OPTION=V] [--json]
                                                       a robot arm: a calibrated URDF, its errors on held-out poses;
                                                       dh=: from a table of Denavit and Hartenberg, and one out
  calibrate hand_eye=eye_in_hand|eye_to_hand data=FILE [OPTION=V] [--json]
                                                       a camera on the hand or beside the robot: its frame, and the
                                                       board's, from pairs of poses; with urdf=FILE and joints in
                                                       the data: arm and camera in one fit
  design machine=NAME data=FILE|plan=NAME [OPTION=V] [--json]
                                                       what such data could and could not tell apart, before fitting
  status [--watch] STUDY_DIR                           how far a sweep is, what failed and why; --watch: until its end
  collect|report STUDY_DIR                             fold journals into tables; tables, figures and the page
  merge A B ... --to C [--keep-first]                  one study of several folders, such as those of shards
  export coco|ioh|mlflow|csv|latex STUDY_DIR --to OUT  a study in the format of other tools, in a new folder
  import coco|ioh FOLDER --to OUT                      published results as a study: report and merge them with ours
  show RUN_ID [--json]                                 one run's story (the first digits of its id suffice)
  compare A B [by=..] [--methods M1 M2] [--json]       the same cells of two studies: where B is better or worse;
                                                       exit 1 where it is worse in some cell; --methods: in one study
  studies [RESULTS] [COLUMN=VALUE ...] [--all] [--json]
                                                       all studies, discoveries and calibrations below a folder:
                                                       optimizer=de since=7d status!=ok words='my note'
  sql "SELECT ..." [--json]                            over all of them: studies, runs, traces, hits, findings, gaps,
                                                       calibrations (needs calibench[sql])
  note STUDY|RUN_ID "TEXT"                             note something of a study or run; without a text, show it
  tag STUDY +paper -draft                              add and remove tags
  archive STUDY [--undo]                               leave it out of lists
  delete STUDY [--yes]                                 delete what bench wrote in it; asks before
  history problem=NAME optimizer=NAME [OPTION=V] [--check] [--json]
                                                       one method over versions of the code, and where it changed;
                                                       --check: exit 1 where the newest study is worse than the tagged
  pack STUDY [--to FILE.zip]                           a study as one file: tables, versions, page, readme
  unpack FILE.zip                                      unpack one that somebody sent, checked, without trust
  ui [RESULTS] [port=8765] [--write]                   all of this in a browser of this machine, sweeps as they run;
                                                       --write: notes and tags too (needs calibench[ui])
  doctor [--json]                                      versions, machine, compiled kernels and extras, for bug reports;
                                                       exit 1 where something that is needed does not load
  choose STUDY_DIR [OPTION=V] [--json]                 the best of the settings swept, with the optimism of the choice
  status|collect|report|merge|export|import|show|compare|choose|history|pack ... [--trust]
                                                       verbs that read import no class that a file names: --trust lets
                                                       them, of files that are yours
"""
_VERBS = {  # file of `bench.commands`, function
    "list": "list:run", "run": "run:run", "identify": "run:identify", "status": "study:status",
    "merge": "study:merge_studies", "compare": "compare:compare_studies", "choose": "compare:choose_setting",
    "collect": "study:collect", "report": "report:report", "export": "exchange:export",
    "import": "exchange:import_study", "show": "study:show",
    "studies": "tracking:list_studies", "sql": "tracking:sql", "note": "tracking:note", "tag": "tracking:tag",
    "archive": "tracking:archive", "delete": "tracking:delete_study", "history": "tracking:history",
    "pack": "tracking:pack_study", "unpack": "tracking:unpack_study", "ui": "tracking:ui",
    "doctor": "doctor:doctor", "paper": "paper:run",
    "discover": "discover:discover", "calibrate": "calibrate:run", "design": "discover:design",
}  # fmt: skip
_READING = {  # take --trust
    "status", "merge", "compare", "choose", "collect", "report", "export", "import", "show", "history", "pack",
}  # fmt: skip


def command() -> None:
    """Be the process `bench`: `main`, and the end of the process."""
    process.at_once()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a pipe or console of another encoding than UTF-8 gets \u2265 for ≥
            stream.reconfigure(errors="backslashreplace")
    main()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the verb that `arguments` (by default the process's) begin with, and exit.

    The threads of linear algebra are read when NumPy is loaded: nothing that this file imports may load it.
    """
    if "numpy" not in sys.modules:  # else `one_thread` holds them, where a run begins
        for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(threads, "1")  # matrices here are small; and the same bits with any number of workers
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # its own keeps some 50 MB of what tables took
    process.rest()
    # problem=my_module:MyProblem is found where the user stands, behind all that has another of its names
    from pathlib import Path

    folder = os.getcwd()
    if Path(folder).resolve() != Path(__file__).resolve().parent.parent:  # our own stays where it is
        sys.path[:] = [entry for entry in sys.path if entry not in ("", folder)] + [folder]
    argv = list(sys.argv[1:] if arguments is None else arguments)
    refused: str | None = None
    try:
        code = _dispatch(argv)
        sys.stdout.flush()
    except (ValueError, ModuleNotFoundError) as error:
        code, refused = 2, str(error)
    except (RecursionError, OverflowError, MemoryError) as error:  # a value that no check expected
        last = extract_tb(error.__traceback__)[-1]
        where = f" ({os.path.basename(last.filename)}, line {last.lineno})"
        text = f"{type(error).__name__}{f': {error}' if str(error) else ''}{where}"
        code, refused = 2, f"the request asks for more than can be done: {text}"
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        full = error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", None))
        room = "; make room and give the same command again: finished runs are kept" if full else ""
        code, refused = 2, f"{where}{error.strerror or error}{room}"
    except KeyboardInterrupt:
        code, refused = 130, "stopped; finished runs are kept, the same command goes on from there"
    except Exception as error:
        from calibench.bench.gate.endings import place_of, text_of

        if not (place := place_of(error)):  # else it is of the user's own code
            raise
        code, refused = 2, f"{type(error).__name__}: {text_of(error)} ({place})"
    finally:
        process.resume()
    if refused is not None:
        print(f"bench: {one_line(refused)}", file=sys.stderr)
    process.ends_with(code)
    sys.exit(code)


def _dispatch(argv: list[str]) -> int:
    if argv[:1] == ["help"] and argv[1:]:
        argv = [argv[1], "--help"]
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(_USAGE, end="")
        return 0 if argv else 2
    if argv[0] == "--version":
        from importlib.metadata import version

        print(f"calibench {version('calibench')}")
        return 0
    for word in argv:
        check_word(word)
    verb, rest = argv[0], argv[1:]
    if verb not in _VERBS:
        from calibench.core.options import suggest

        raise ValueError(f"unknown verb {verb!r}; {suggest(verb, _VERBS)}")
    if "-h" in rest or "--help" in rest:
        from calibench.bench.commands.verb_help import help_of_verb

        print(help_of_verb(verb, _USAGE), end="")
        return 0
    module, _, function = _VERBS[verb].partition(":")
    call: Callable[[list[str]], int] = getattr(import_module(f"calibench.bench.commands.{module}"), function)
    if verb != "run":  # which loads further, with the problems and optimisers that are asked for
        process.resume()
    if verb not in _READING:
        return call(rest)
    from calibench.core.registry import names_of_files, take_not_imported

    take_not_imported()  # what others in this process have asked for
    with names_of_files(trust="--trust" in rest):
        code = call([word for word in rest if word != "--trust"])
    if classes := take_not_imported():  # that would have told more
        first = dict([*classes][::-1])  # of each kind one is named
        named = ", ".join(f"the {kind} is {shortened(name)}" for kind, name in first.items())
        more = f" and {len(classes) - len(first)} more" if len(classes) > len(first) else ""
        left_out = "; ".join(dict.fromkeys(what for whats in classes.values() for what in whats))
        line = f"bench: {one_line(named + more)}, which reading does not import; --trust does"
        print(f"{line}. Left out: {left_out}" if left_out else line, file=sys.stderr)
    return code
