"""The paper's equations (29)-(44), written out slowly: the twins that the compiled kernels are held against.

Nothing here knows how the kernels do it: coordinates are not centred, the passive angles are arctangents, each of the
components of E1 and E2 stands as printed. A machine is a mapping name -> number: xa1 ... ya3, la1 ... lb3, z1 ... z3
(for J3 lac1 ... las3 in place of la and z); `readings` has shape (n, 3), rad. Errata applied: the squares lost in (32),
y_a1 in row 1 of (38), the quadrants of (34) and (44).
"""

import numpy as np

LEGS = (1, 2, 3)


def j1(machine, readings):
    """Return J1, eq. (37): the squared closed-loop errors E1 of the paper's angles, summed."""
    return float((leg_vectors(machine, readings) ** 2).sum())


def j2(machine, readings):
    """Return J2, eq. (39)."""
    xb, yb = passive_joints(machine, readings)
    return float((circle_errors(machine, xb, yb) ** 2).sum())


def j3(machine, readings):
    """Return J3, eq. (43), of a machine in the coordinates l_ac, l_as."""
    xb, yb = passive_joints_decoupled(machine, readings)
    return float((circle_errors(machine, xb, yb) ** 2).sum())


def leg_vectors(machine, readings):
    """Return E1, eq. (36), shape (6, n), with (x, y) from (33) and the passive angles from (34)."""
    xb, yb = passive_joints(machine, readings)
    x, y = end_effector(machine, xb, yb)
    rows = []
    for i in LEGS:
        theta_a = readings[:, i - 1] + machine[f"z{i}"]  # (35)
        theta_b = np.arctan2(y - yb[i], x - xb[i])  # (34), arctg of the quotient corrected
        la, lb = machine[f"la{i}"], machine[f"lb{i}"]
        rows.append(x - machine[f"xa{i}"] - la * np.cos(theta_a) - lb * np.cos(theta_b))
        rows.append(y - machine[f"ya{i}"] - la * np.sin(theta_a) - lb * np.sin(theta_b))
    return np.array(rows)


def circle_errors(machine, xb, yb):
    """Return E2, eq. (38) (row 1 with y_a1), or E3, eq. (42), shape (3, n): what (31) lacks, (x, y) from (33)."""
    x, y = end_effector(machine, xb, yb)
    return np.array([(x - xb[i]) ** 2 + (y - yb[i]) ** 2 - machine[f"lb{i}"] ** 2 for i in LEGS])


def passive_joints(machine, readings):
    """Return x_b and y_b, leg -> shape (n,), eq. (30) with (35)."""
    xb, yb = {}, {}
    for i in LEGS:
        theta_a = readings[:, i - 1] + machine[f"z{i}"]
        xb[i] = machine[f"xa{i}"] + machine[f"la{i}"] * np.cos(theta_a)
        yb[i] = machine[f"ya{i}"] + machine[f"la{i}"] * np.sin(theta_a)
    return xb, yb


def passive_joints_decoupled(machine, readings):
    """Return the same from l_ac and l_as, eq. (30) with (41)."""
    xb, yb = {}, {}
    for i in LEGS:
        reading, lac, las = readings[:, i - 1], machine[f"lac{i}"], machine[f"las{i}"]
        xb[i] = machine[f"xa{i}"] + (lac * np.cos(reading) - las * np.sin(reading))
        yb[i] = machine[f"ya{i}"] + (las * np.cos(reading) + lac * np.sin(reading))
    return xb, yb


def end_effector(machine, xb, yb):
    """Return x and y, eq. (33), with d_i = x_b^2 + y_b^2 - l_b^2."""
    d = {i: xb[i] ** 2 + yb[i] ** 2 - machine[f"lb{i}"] ** 2 for i in LEGS}
    below = 2 * (xb[1] * (yb[2] - yb[3]) + xb[2] * (yb[3] - yb[1]) + xb[3] * (yb[1] - yb[2]))
    x = (d[1] * (yb[2] - yb[3]) + d[2] * (yb[3] - yb[1]) + d[3] * (yb[1] - yb[2])) / below
    y = (d[1] * (xb[3] - xb[2]) + d[2] * (xb[1] - xb[3]) + d[3] * (xb[2] - xb[1])) / below
    return x, y


def active_angle(machine, leg, x, y, elbow):
    """Return theta_a of one leg at the end-effector (x, y) in the branch `elbow` (+1 or -1), by the law of cosines."""
    dx, dy = x - machine[f"xa{leg}"], y - machine[f"ya{leg}"]
    la, lb, reach2 = machine[f"la{leg}"], machine[f"lb{leg}"], dx**2 + dy**2
    return np.arctan2(dy, dx) + elbow * np.arccos((la**2 + reach2 - lb**2) / (2 * la * np.sqrt(reach2)))


def kmrmse(machine, readings, x, y):
    """Return eq. (40) against the actual end-effector coordinates x, y, shape (n,)."""
    x_hat, y_hat = end_effector(machine, *passive_joints(machine, readings))
    return float(np.sqrt(np.mean((x - x_hat) ** 2 + (y - y_hat) ** 2)))


def decoupled(machine):
    """Return the machine with l_ac = l_a cos z and l_as = l_a sin z in place of l_a and z."""
    kept = {name: value for name, value in machine.items() if not name.startswith(("la", "z"))}
    for i in LEGS:
        kept[f"lac{i}"] = machine[f"la{i}"] * np.cos(machine[f"z{i}"])
        kept[f"las{i}"] = machine[f"la{i}"] * np.sin(machine[f"z{i}"])
    return kept


def coupled(machine):
    """Return the machine with l_a and z again, eq. (44) with its root, its quotient and its quadrant restored."""
    kept = {name: value for name, value in machine.items() if not name.startswith(("lac", "las"))}
    for i in LEGS:
        lac, las = machine[f"lac{i}"], machine[f"las{i}"]
        kept[f"la{i}"], kept[f"z{i}"] = np.sqrt(lac**2 + las**2), np.arctan2(las, lac)
    return kept
