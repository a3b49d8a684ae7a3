"""What follows `bench`: a file a verb, each with ``run(words) -> exit code``. `bench.cli` tells which file is whose."""
