"""The machines whose data can be searched for a missing effect, a folder each: its formulation, checks and effects."""

from calibench.discrepancy.machines import arm, delta, gpm2002, mount, orthoglide, simulator, table
from calibench.discrepancy.registries import machines

__all__ = ["arm", "delta", "gpm2002", "make", "mount", "names", "orthoglide", "simulator", "table"]
names = machines.names
make = machines.make
