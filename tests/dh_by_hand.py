"""Tables of Denavit and Hartenberg as their makers and authors print them, and kinematics written from the textbooks.

Shares nothing with what it tests. Lengths here are m and angles rad, as printed.
"""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np

# a, alpha, d, theta's constant part, "r" or "p"
UR5 = [  # Universal Robots, "DH parameters for calculations of kinematics and dynamics"
    (0, pi / 2, 0.089159, 0, "r"), (-0.425, 0, 0, 0, "r"), (-0.39225, 0, 0, 0, "r"), (0, pi / 2, 0.10915, 0, "r"),
    (0, -pi / 2, 0.09465, 0, "r"), (0, 0, 0.0823, 0, "r"),
]  # fmt: skip
UR10 = [  # the same page; d4 with the digits of the maker's URDF
    (0, pi / 2, 0.1273, 0, "r"), (-0.612, 0, 0, 0, "r"), (-0.5723, 0, 0, 0, "r"), (0, pi / 2, 0.163941, 0, "r"),
    (0, -pi / 2, 0.1157, 0, "r"), (0, 0, 0.0922, 0, "r"),
]  # fmt: skip
PUMA = [  # Corke and Armstrong-Helouvry 1994, standard
    (0, pi / 2, 0, 0, "r"), (0.4318, 0, 0, 0, "r"), (0.0203, -pi / 2, 0.15005, 0, "r"), (0, pi / 2, 0.4318, 0, "r"),
    (0, -pi / 2, 0, 0, "r"), (0, 0, 0, 0, "r"),
]  # fmt: skip
PUMA_CRAIG = [  # Craig 1986, figure 3.21, modified: a and alpha of the row before
    (0, 0, 0, 0, "r"), (0, -pi / 2, 0, 0, "r"), (0.4318, 0, 0.14909, 0, "r"), (0.02032, -pi / 2, 0.43307, 0, "r"),
    (0, pi / 2, 0, 0, "r"), (0, -pi / 2, 0, 0, "r"),
]  # fmt: skip
STANFORD = [  # Paul 1981, standard; with the lengths of Corke's toolbox
    (0, -pi / 2, 0.412, 0, "r"), (0, pi / 2, 0.154, 0, "r"), (0.0203, 0, 0, -pi / 2, "p"), (0, -pi / 2, 0, 0, "r"),
    (0, pi / 2, 0, 0, "r"), (0, 0, 0.263, 0, "r"),
]  # fmt: skip
NUMBERS = ("a", "alpha", "d", "theta")


def standard(a, alpha, d, theta, beta=0.0):
    """Return A_i of Denavit and Hartenberg, as Paul prints it; then Hayati's turn beta about y."""
    st, ct, sa, ca = sin(theta), cos(theta), sin(alpha), cos(alpha)
    made = np.array(
        [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]], dtype=float
    )
    return made @ [[cos(beta), 0, sin(beta), 0], [0, 1, 0, 0], [-sin(beta), 0, cos(beta), 0], [0, 0, 0, 1]]


def modified(a, alpha, d, theta, beta=0.0):
    """Return the transform from frame i - 1 to i of Craig, his equation (3.6); with Hayati's turn behind alpha."""
    if beta:
        leant = [[cos(beta), 0, sin(beta), 0], [0, 1, 0, 0], [-sin(beta), 0, cos(beta), 0], [0, 0, 0, 1]]
        return modified(0, alpha, 0, 0) @ leant @ modified(a, 0, d, theta)
    st, ct, sa, ca = sin(theta), cos(theta), sin(alpha), cos(alpha)
    return np.array([
        [ct, -st, 0, a], [st * ca, ct * ca, -sa, -sa * d], [st * sa, ct * sa, ca, ca * d], [0, 0, 0, 1],
    ], dtype=float)  # fmt: skip


def reached(rows, q, of=standard, errors=None):
    """Return the flange in the base, (n, 4, 4) [m]; `errors` are (number, row) -> m or rad, beta among them."""
    errors = errors or {}
    found = []
    for posture in np.atleast_2d(q):
        at = np.eye(4)
        for k, ((a, alpha, d, theta, kind), move) in enumerate(zip(rows, posture, strict=True)):
            more = [errors.get((one, k), 0.0) for one in (*NUMBERS, "beta")]
            numbers = [a + more[0], alpha + more[1], d + more[2], theta + more[3]]
            numbers[3 if kind == "r" else 2] += move
            at = at @ of(*numbers, more[4])
        found.append(at)
    return np.array(found)


def as_csv(rows, heads="joint,type,a [m],alpha [rad],d [m],theta [rad]", names=None, scale=(1, 1, 1, 1)):
    """Return the rows as the text of a CSV file."""
    lines = [heads]
    for k, row in enumerate(rows, start=1):
        kind = {"r": "revolute", "p": "prismatic"}[row[4]]
        numbers = [repr(v * s) for v, s in zip(row[:4], scale, strict=True)]
        lines.append(",".join([names[k - 1] if names else f"axis_{k}", kind, *numbers]))
    return "\n".join(lines) + "\n"
