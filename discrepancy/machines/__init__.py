"""The machines whose data can be searched for a missing effect, a folder each: its formulation, checks and effects."""

from calibench.discrepancy.machines import (
    arm as arm,
    delta as delta,
    gpm2002 as gpm2002,
    mount as mount,
    orthoglide as orthoglide,
    simulator as simulator,
    table as table,
)
from calibench.discrepancy.registries import machines

names = machines.names
make = machines.make
