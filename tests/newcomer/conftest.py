"""The stories are scripts with a folder of their own to run in: they are given, not imported."""

collect_ignore = ["first_plot.py", "fresh.py", "own_csv.py", "own_report.py", "own_robot.py"]
