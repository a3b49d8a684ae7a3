"""What is asked for and carried out: a command line becomes runs, runs that are done are skipped, the rest are
executed."""
