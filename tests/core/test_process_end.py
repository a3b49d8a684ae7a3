"""A `bench` process ends at once, and nothing is lost by it."""

import os
import subprocess
import sys

import pytest

AT_ONCE = "import atexit, sys; from calibench.core import process as process_end; process_end.at_once()\n"


def ended(script, *arguments):
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False, timeout=120
    )
    return done.returncode, done.stdout, done.stderr


def test_what_was_registered_for_the_end_is_done_and_what_was_printed_is_written():
    script = (
        AT_ONCE
        + "atexit.register(print, 'registered')\nprint('printed', end=' ')\nprocess_end.ends_with(3); sys.exit(3)"
    )
    assert ended(script) == (3, "printed registered\n", "")


@pytest.mark.skipif(os.name != "posix", reason="the C library is named otherwise")
def test_what_c_code_printed_is_written_too():
    script = AT_ONCE + "import ctypes\nctypes.CDLL(None).printf(b'from C')\nprocess_end.ends_with(0)"
    assert ended(script) == (0, "from C", "")


def test_modules_are_not_taken_apart():
    script = "class Late:\n    def __del__(self): print('taken apart')\nlate = Late()\n"
    assert ended(script)[1] == "taken apart\n"
    assert ended(AT_ONCE + script + "process_end.ends_with(0)") == (0, "", "")


def test_an_exception_ends_the_process_as_ever():
    code, _, told = ended(AT_ONCE + "raise KeyError('lost')")
    assert code == 1
    assert told.endswith("KeyError: 'lost'\n")


def test_a_script_that_calls_main_goes_on_and_has_its_own_exit_code():
    script = (
        "import sys; from calibench.bench.cli import main\n"
        "try: main()\nexcept SystemExit as end: print('verb:', end.code)\nsys.exit(5)"
    )
    code, told, _ = ended(script, "list", "optimizers")
    assert (code, told.splitlines()[-1]) == (5, "verb: 0")


@pytest.mark.parametrize(("words", "code"), [(["list", "optimizers"], 0), (["lst"], 2), ([], 2)])
def test_the_command_has_the_exit_code_of_its_verb(words, code):
    done = subprocess.run([sys.executable, "-m", "calibench", *words], capture_output=True, check=False, timeout=120)
    assert done.returncode == code
    assert done.stdout or done.stderr
