"""A chain of joints, from a URDF or a table of joints, and its kinematics."""
