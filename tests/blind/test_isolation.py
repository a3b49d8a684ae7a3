"""The simulators share nothing with what they put to the test."""

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOM = ROOT / "benchmarks" / "blind"
ALLOWED = {"numpy", "scipy", "pyarrow", "benchmarks"} | set(sys.stdlib_module_names)


def imported(path):
    """Return the modules that a file imports, wherever in it, `from tests.x import y` as x."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add("." * node.level + (node.module or ""))
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "__import__")):
            found.add("called: " + ast.unparse(node))
    return found


def test_every_file_of_the_room_imports_only_numpy_scipy_arrow_and_itself():
    files = sorted(ROOM.glob("**/*.py"))
    assert len(files) > 10
    for path in files:
        for module in imported(path):
            assert module.split(".")[0] in ALLOWED, f"{path.name} imports {module}"
            own = module.startswith("benchmarks.blind")
            assert own or module.split(".")[0] != "benchmarks", f"{path.name}: {module}"


def test_nothing_of_the_project_is_loaded_when_the_simulator_and_the_scorer_are():
    rooms = {path.parent.name for path in ROOT.glob("*/__init__.py")} - {"tests", "benchmarks"}
    assert {"problems", "bench"} <= rooms
    code = (
        "import sys, benchmarks.blind.write, benchmarks.blind.score\n"
        "import benchmarks.blind.laws, benchmarks.blind.malformed\n"
        f"print(sorted({{m.split('.')[0] for m in sys.modules}} & {rooms!r}))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
