"""The calibration of a robot arm: a URDF and any file of readings in, a calibrated URDF with its errors out."""
