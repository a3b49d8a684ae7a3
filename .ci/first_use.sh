#!/bin/bash
# Seconds of a stranger's first use, by step: .ci/first_use.sh REPOSITORY FOLDER
# FOLDER must not exist: the clone goes there, and a home in which nothing is kept. pip's cache is empty, too.
set -euo pipefail
[ $# = 2 ] && [ ! -e "$2" ] || { echo "usage: $0 REPOSITORY FOLDER, a folder that does not exist yet"; exit 2; }
repository=$(realpath "$1")
mkdir -p "$2/home" && cd "$2"
export HOME=$PWD/home TIMEFORMAT="%R s, of processors %U + %S"
unset XDG_CACHE_HOME PYTHONDONTWRITEBYTECODE MAKEFLAGS
log=$PWD/log

step() {
    printf '%s: ' "$*"
    time "$@" >>"$log" 2>&1
}

step git clone -q "$repository" clone
cd clone
step make venv
step .venv/bin/python -c 'import calibench; calibench.execute'
step .venv/bin/bench run problem=sensor_zero optimizer=de budget=2000 seeds=3
step .venv/bin/bench run problem=sensor_zero optimizer=de budget=2000 seeds=3 study=again
step .venv/bin/bench report results/adhoc
step .venv/bin/bench discover machine=gpm2002 data=demo_backlash
