"""Child processes: forked for a run or a batch, heard, and ended with all processes that they have started."""
