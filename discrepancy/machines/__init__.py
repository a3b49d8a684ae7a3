"""The machines whose data can be searched for a missing effect, a folder each: its formulation, checks and effects."""

from calibench.discrepancy.machines import arm as arm
from calibench.discrepancy.machines import delta as delta
from calibench.discrepancy.machines import gpm2002 as gpm2002
from calibench.discrepancy.machines import mount as mount
from calibench.discrepancy.machines import orthoglide as orthoglide
from calibench.discrepancy.machines import table as table
from calibench.discrepancy.registries import machines

names = machines.names
make = machines.make
