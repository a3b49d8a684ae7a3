"""Child processes: forked for a run or a batch, heard, and ended with all that they have started."""
