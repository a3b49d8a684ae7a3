"""From `git clone` to a calibrated URDF: an arm's description and poses that were measured, by docs/my-robot.md.

python tests/newcomer/own_robot.py [REPOSITORY]
"""

from fresh import Newcomer, story


def follow(newcomer: Newcomer) -> None:
    """Make the page's arm and its poses, calibrate, and find the number that was wrong put right."""
    newcomer.save("measure.py", newcomer.code("docs/my-robot.md", "my_poses.csv"))
    newcomer.run("python", "measure.py")
    newcomer.do("README.md", "bench calibrate urdf=my_arm.urdf")
    newcomer.needs("results/calibrate/my_poses/report.html", least=10_000)
    calibrated = (newcomer.folder / "results/calibrate/my_poses/my_arm_calibrated.urdf").read_text(encoding="utf-8")
    if 'xyz="0 0 0.6008' not in calibrated:
        raise SystemExit("docs/my-robot.md promises an upper arm of 0.6008 m")


if __name__ == "__main__":
    story("from git clone to a calibrated URDF", follow)
