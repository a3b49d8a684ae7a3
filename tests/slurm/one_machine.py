"""A real Slurm on this machine alone: munge, a controller and one node, started and stopped, all files in one folder.

As root, with Debian's packages (``python tests/slurm/one_machine.py install``)::

    python tests/slurm/one_machine.py start FOLDER     prints what to set: export SLURM_CONF=FOLDER/slurm.conf
    python tests/slurm/one_machine.py stop FOLDER      ends the jobs, then the daemons

Processes are tracked by their parents (proctrack/linuxproc) and bound to nothing (task/none); nothing is accounted. So
it needs no cgroups, no database and no other machine. Neither /etc/slurm nor /etc/munge is read.
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

PACKAGES = ("slurm-wlm", "munge")
_START = 30.0  # seconds for the node to be there
_END = 40.0  # seconds for jobs to end: Slurm gives them 30 after its first signal
_CONF = """
ClusterName=one
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller}
SlurmdPort={node}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
MpiDefault=none
ReturnToService=2
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
PlugStackConfig={folder}/plugstack.conf
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} State=UNKNOWN
PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE OverSubscribe=YES State=UP
"""


class CannotStart(RuntimeError):
    """Slurm is not there, or does not start; the text says why."""


def start(folder: Path) -> dict[str, str]:
    """Start it; return the environment in which sbatch, srun and the others find it. Raises `CannotStart`."""
    lacking = [program for program in ("munged", "slurmctld", "slurmd", "sbatch") if _program(program) is None]
    if lacking:
        raise CannotStart(f"{', '.join(lacking)} missing (apt-get install {' '.join(PACKAGES)})")
    if os.geteuid() != 0:
        raise CannotStart("slurmd needs root")
    for name in ("state", "spool"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    folder.chmod(0o755)
    host = socket.gethostname().partition(".")[0]
    conf = folder / "slurm.conf"
    conf.write_text(
        _CONF.format(host=host, folder=folder, controller=_free_port(), node=_free_port(), cpus=os.cpu_count() or 1)
    )
    (folder / "plugstack.conf").write_text("")
    key = folder / "munge.key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o400)
    environment = {**os.environ, "SLURM_CONF": str(conf)}
    files = {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
    munge = [f"--{name}={folder}/munge.{end}" for name, end in files.items()]
    try:
        _begin(folder, "munged", [*munge, "--foreground", "--force", "--num-threads=2"], environment)
        _wait_for(lambda: (folder / "munge.socket").exists(), folder, "munged")
        _begin(folder, "slurmctld", ["-D", "-f", str(conf)], environment)
        _begin(folder, "slurmd", ["-D", "-f", str(conf), "-N", host], environment)
        _wait_for(lambda: _says(["sinfo", "-h", "-o", "%t"], environment) in ("idle", "mix", "alloc"), folder, "slurmd")
    except BaseException:
        stop(folder)
        raise
    return environment


def stop(folder: Path) -> None:
    """End all jobs and the daemons."""
    environment = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf")}
    if _pid(folder, "slurmctld") is not None and _says(["squeue", "-h"], environment):
        _says(["scancel", "--full", "--user=root"], environment)
        end = time.monotonic() + _END
        while _says(["squeue", "-h"], environment) and time.monotonic() < end:
            time.sleep(0.2)
    for daemon in ("slurmd", "slurmctld", "munged"):
        _finish(folder, daemon)


def _begin(folder: Path, daemon: str, words: list[str], environment: dict[str, str]) -> None:
    with open(folder / f"{daemon}.log", "w") as log:
        process = subprocess.Popen(
            [str(_program(daemon)), *words], env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            start_new_session=True,
        )  # fmt: skip
    (folder / f"{daemon}.started").write_text(str(process.pid))
    _CHILDREN[process.pid] = process


_CHILDREN: dict[int, subprocess.Popen[bytes]] = {}  # those that this process has to wait for


def _finish(folder: Path, daemon: str) -> None:
    pid = _pid(folder, daemon)
    if pid is None:
        return
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.kill(pid, number)
        end = time.monotonic() + 10.0
        while _is_there(pid) and time.monotonic() < end:
            time.sleep(0.05)
    (folder / f"{daemon}.started").unlink()


def _pid(folder: Path, daemon: str) -> int | None:
    with suppress(OSError, ValueError):
        return int((folder / f"{daemon}.started").read_text())
    return None


def _is_there(pid: int) -> bool:
    child = _CHILDREN.get(pid)
    if child is not None:
        return child.poll() is None
    with suppress(ProcessLookupError):
        os.kill(pid, 0)
        return True
    return False


def _wait_for(condition: object, folder: Path, daemon: str) -> None:
    assert callable(condition)
    end = time.monotonic() + _START
    while not condition():
        pid = _pid(folder, daemon)
        if time.monotonic() > end or pid is None or not _is_there(pid):
            said = (folder / f"{daemon}.log").read_text().strip().splitlines()
            raise CannotStart(f"{daemon} does not start: {said[-1] if said else 'it says nothing'}")
        time.sleep(0.1)


def _says(command: list[str], environment: dict[str, str]) -> str:
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    return done.stdout.strip()


def _program(name: str) -> str | None:
    return shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
        return port


if __name__ == "__main__":
    verb, *rest = sys.argv[1:] or ["help"]
    if verb == "install":
        sys.exit(subprocess.run(["apt-get", "install", "-y", "--no-install-recommends", *PACKAGES]).returncode)
    if verb not in ("start", "stop") or len(rest) != 1:
        sys.exit(str(__doc__))
    where = Path(rest[0]).resolve()
    if verb == "stop":
        stop(where)
    else:
        where.mkdir(parents=True, exist_ok=True)
        try:
            start(where)
        except CannotStart as why:
            sys.exit(str(why))
        print(f"export SLURM_CONF={where}/slurm.conf")
