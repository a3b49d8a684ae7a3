"""Two measured arms on readings that no fit saw: what geometry leaves, what named effects leave, and how surely.

The tables of docs/arm-rates.md, each by one command; FOLDER is where their authors' files lie (problems/data/arms/
LICENSES.md says whose they are, and which commit):

    python -m benchmarks.arms within FOLDER B C D     a UR10, every fifth pose of a series kept back
    python -m benchmarks.arms levels FOLDER B C D     all five choices of it, by how much `bench calibrate` frees
    python -m benchmarks.arms shuffled FOLDER D       the same with its rows in an order of chance
    python -m benchmarks.arms plain FOLDER B C D      the same by a plain script with a walk of its own
    python -m benchmarks.arms across FOLDER           two series fitted, the third predicted
    python -m benchmarks.arms sockets FOLDER          a Panda, places of its sockets kept back
"""
