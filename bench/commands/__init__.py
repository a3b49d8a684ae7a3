"""The commands of `bench`, one file each, with ``run(words) -> exit code``. `bench.cli` maps commands to files."""
