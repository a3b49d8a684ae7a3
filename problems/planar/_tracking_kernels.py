"""The projected tracking error of sensor zero positions, compiled. Equation numbers: Cong et al. 2008, section 2.

The hand stands at O + x and is believed to stand at O, so the offsets are wrong by dz = theta(O) - theta(O + x), with
theta the inverse kinematics. Commanded to the angles theta(p), the three motors cannot all be satisfied; being equally
stiff they settle where f(P) = |theta(P) + dz - theta(p)|^2 is least. What is left there are the tracking errors
dtheta_a, eq. (3), and their infeasible part is the residual, eq. (17).

`reference`, shape (4,), is O and the x at which the hand stands on O: (0, 0) in the paper, which x - 0 leaves as it is.

A machine is the vector of 15 numbers of `_closed_loop_kernels` (its offsets are not used). `commanded`, shape (n, 3),
are the angles theta(p) of `points`, shape (n, 2); `samples` is what `_settling_kernels` needs of both; `projectors`,
shape (n, 3, 3), are P of eq. (15) there; `errors`, shape (n, 3), are those of the recorded readings, eq. (20). Where a
leg is out of reach, or would be stretched before the motors balance, all is NaN.
"""

import math

import numpy as np

from calibench.core.compilation.compiled import njit, part
from calibench.problems.base import Array
from calibench.problems.planar._settling_kernels import LANES, ROOM, SETTLED, SMALL, STEPS, errors_at, rests, settle


@njit()
def cost(
    x: Array, machine: Array, reference: Array, points: Array, commanded: Array, projectors: Array,
    errors: Array, samples: Array,
) -> float:  # fmt: skip
    """Return E [rad^2], eq. (19), of one displacement x = (dx, dy), shape (2,), mm."""
    r, room = np.empty(errors.size), np.empty(ROOM * LANES)
    return _fill(x, machine, reference, points, commanded, projectors, errors, samples, r, room)


@njit()
def batch(
    many: Array, machine: Array, reference: Array, points: Array, commanded: Array, projectors: Array,
    errors: Array, samples: Array,
) -> Array:  # fmt: skip
    """Return E, shape (k,), of displacements `many`, shape (k, 2): bit for bit those of `cost`."""
    values = np.empty(many.shape[0])
    r, room = np.empty(errors.size), np.empty(ROOM * LANES)
    for k in range(many.shape[0]):
        values[k] = _fill(many[k], machine, reference, points, commanded, projectors, errors, samples, r, room)
    return values


@njit()
def residuals(
    x: Array, machine: Array, reference: Array, points: Array, commanded: Array, projectors: Array,
    errors: Array, samples: Array,
) -> Array:  # fmt: skip
    """Return P dtheta_a / sqrt(n) [rad], eq. (17), shape (3n,), whose squares sum to E."""
    r, room = np.empty(errors.size), np.empty(ROOM * LANES)
    _fill(x, machine, reference, points, commanded, projectors, errors, samples, r, room)
    return r


@njit()
def jacobian(
    x: Array, machine: Array, reference: Array, points: Array, commanded: Array, projectors: Array,
    errors: Array, samples: Array,
) -> Array:  # fmt: skip
    """Return the derivative of `residuals` in (dx, dy), shape (3n, 2), rad/mm.

    The pose is where J^T e = 0, e = theta(P) + dz - theta(p). With M = J^T J + sum e_i theta_i'' the implicit function
    theorem gives dP = -M^-1 J^T ddz, so de = (I - J M^-1 J^T) ddz, and ddz = -J(O + x).
    """
    n = points.shape[0]
    scale = 1.0 / math.sqrt(n)
    result = np.empty((3 * n, 2))
    poses = settled(x, machine, reference, points, commanded, samples)
    dz = offset_errors(x, machine, reference)
    slope = np.empty((3, 2))
    hand_x, hand_y = _hand(x, reference)
    for i in range(3):
        _, slope[i, 0], slope[i, 1], _, _, _ = _leg(machine, i, hand_x, hand_y)
    legs, de = np.empty((3, 2)), np.empty(3)
    for j in range(n):
        mxx = mxy = myy = 0.0
        for i in range(3):
            theta, gx, gy, hxx, hxy, hyy = _leg(machine, i, poses[j, 0], poses[j, 1])
            e = theta + dz[i] - commanded[j, i]
            mxx, mxy, myy = mxx + gx * gx + e * hxx, mxy + gx * gy + e * hxy, myy + gy * gy + e * hyy
            legs[i, 0], legs[i, 1] = gx, gy
        det = mxx * myy - mxy * mxy
        for c in range(2):
            bx = by = 0.0
            for i in range(3):
                bx -= legs[i, 0] * slope[i, c]
                by -= legs[i, 1] * slope[i, c]
            px, py = -(myy * bx - mxy * by) / det, -(mxx * by - mxy * bx) / det
            for i in range(3):
                de[i] = legs[i, 0] * px + legs[i, 1] * py - slope[i, c]
            for i in range(3):
                p = projectors[j, i]
                result[3 * j + i, c] = scale * (p[0] * de[0] + p[1] * de[1] + p[2] * de[2])
    return result


@njit()
def settled(x: Array, machine: Array, reference: Array, points: Array, commanded: Array, samples: Array) -> Array:
    """Return the poses at which the motors come to rest, shape (n, 2), mm: NaN where they find none."""
    dz = offset_errors(x, machine, reference)
    result = np.empty(points.shape)
    room = np.empty(ROOM * LANES)
    for block in range(samples.shape[0]):
        settle(machine, dz, samples[block], room)
        for lane in range(min(LANES, points.shape[0] - block * LANES)):
            j = block * LANES + lane
            if rests(room, lane):
                result[j, 0], result[j, 1] = room[lane], room[LANES + lane]
            else:
                result[j, 0], result[j, 1] = _settle(machine, dz, commanded[j], points[j])
    return result


@njit()
def offset_errors(x: Array, machine: Array, reference: Array) -> Array:
    """Return dz = theta(O) - theta(O + x), shape (3,), rad: what the estimated offsets are too large by, eq. (4)."""
    dz = np.empty(3)
    hand_x, hand_y = _hand(x, reference)
    for i in range(3):
        believed = _leg(machine, i, reference[0], reference[1])[0]
        dz[i] = believed - _leg(machine, i, hand_x, hand_y)[0]  # step 2
    return dz


@njit()
def joint_angles(machine: Array, positions: Array) -> tuple[Array, Array]:
    """Return the inverse kinematics, shape (n, 3), rad, and its Jacobian J, eq. (11), shape (n, 3, 2), rad/mm."""
    n = positions.shape[0]
    angles, slopes = np.empty((n, 3)), np.empty((n, 3, 2))
    for j in range(n):
        for i in range(3):
            theta, gx, gy, _, _, _ = _leg(machine, i, positions[j, 0], positions[j, 1])
            angles[j, i], slopes[j, i, 0], slopes[j, i, 1] = theta, gx, gy
    return angles, slopes


@part()
def _fill(
    x: Array, machine: Array, reference: Array, points: Array, commanded: Array, projectors: Array,
    errors: Array, samples: Array, r: Array, room: Array,
) -> float:  # fmt: skip
    """Fill r with the residuals and return the sum of their squares."""
    n = points.shape[0]
    scale = 1.0 / math.sqrt(n)  # the 1/n of eq. (19)
    dz = offset_errors(x, machine, reference)
    total = 0.0
    for block in range(samples.shape[0]):
        settle(machine, dz, samples[block], room)
        for lane in range(min(LANES, n - block * LANES)):
            j = block * LANES + lane
            if rests(room, lane):
                e0, e1, e2 = errors_at(room, lane)
            else:
                e0, e1, e2 = _errors_without_lanes(machine, dz, commanded[j], points[j])
            e0, e1, e2 = e0 + errors[j, 0], e1 + errors[j, 1], e2 + errors[j, 2]  # eq. (20)
            for i in range(3):
                p = projectors[j, i]
                r[3 * j + i] = scale * (p[0] * e0 + p[1] * e1 + p[2] * e2)  # eq. (17)
                total += r[3 * j + i] * r[3 * j + i]
    return total


@part()
def _errors_without_lanes(machine: Array, dz: Array, target: Array, point: Array) -> tuple[float, float, float]:
    """Return theta(P) + dz - target, rad, where the motors come to rest; NaN where they do not."""
    x, y = _settle(machine, dz, target, point)
    return (
        _leg(machine, 0, x, y)[0] + dz[0] - target[0],
        _leg(machine, 1, x, y)[0] + dz[1] - target[1],
        _leg(machine, 2, x, y)[0] + dz[2] - target[2],
    )


@part()
def _hand(x: Array, reference: Array) -> tuple[float, float]:
    """Return where the hand stands: O + x, or where x is measured from a mark, O + x - truth."""
    return reference[0] + (x[0] - reference[2]), reference[1] + (x[1] - reference[3])


@njit()
def _settle(machine: Array, dz: Array, target: Array, point: Array) -> tuple[float, float]:
    """Return the pose of least f = |theta(P) + dz - target|^2, by Newton's method from `point`.

    A step that finds f larger, or a leg out of reach, is halved; where f is not convex it is that of Gauss-Newton.
    """
    x, y = point
    sx = sy = 0.0
    least = math.inf
    for _ in range(STEPS):
        f = fx = fy = nxx = nxy = nyy = hxx = hxy = hyy = 0.0
        for i in range(3):
            theta, gx, gy, txx, txy, tyy = _leg(machine, i, x, y)
            e = theta + dz[i] - target[i]
            f += e * e
            fx, fy = fx + gx * e, fy + gy * e
            nxx, nxy, nyy = nxx + gx * gx, nxy + gx * gy, nyy + gy * gy
            hxx, hxy, hyy = hxx + e * txx, hxy + e * txy, hyy + e * tyy
        if not (f <= least or (f < math.inf and sx * sx + sy * sy < SMALL * SMALL)):
            sx, sy = 0.5 * sx, 0.5 * sy
            x, y = x + sx, y + sy
            continue
        least = f
        mxx, mxy, myy = nxx + hxx, nxy + hxy, nyy + hyy
        if not (mxx > 0.0 and mxx * myy > mxy * mxy):
            mxx, mxy, myy = nxx, nxy, nyy
        det = mxx * myy - mxy * mxy
        sx, sy = (myy * fx - mxy * fy) / det, (mxx * fy - mxy * fx) / det
        x, y = x - sx, y - sy
        if sx * sx + sy * sy < SETTLED * SETTLED:
            return x, y
    return math.nan, math.nan


@part()
def _leg(machine: Array, i: int, x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """Return theta of leg i at (x, y), its gradient [rad/mm], and its second derivatives xx, xy, yy; or six NaN.

    With a the active link (from A to B), v the passive one (from B to P) and a' = (-a_y, a_x), the closed loop
    |v| = l_b gives the gradient g = v / (v.a'), eq. (11), and from that the second derivatives
    (I - a' g^T - g a'^T + (a.(a + v)) g g^T) / (v.a').
    """
    la, lb = machine[6 + i], machine[9 + i]
    dx, dy = x - machine[2 * i], y - machine[2 * i + 1]
    reach = math.sqrt(dx * dx + dy * dy)
    c = (la * la + reach * reach - lb * lb) / (2.0 * la * reach) if reach > 0.0 else math.nan
    if not -1.0 < c < 1.0:  # out of reach
        return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
    s = math.sqrt((1.0 - c) * (1.0 + c))
    theta = math.atan2(dy, dx) + math.acos(c)
    ax, ay = la * (c * dx - s * dy) / reach, la * (c * dy + s * dx) / reach  # la (cos, sin) theta
    vx, vy = dx - ax, dy - ay
    d = ax * vy - ay * vx
    gx, gy = vx / d, vy / d
    k = ax * dx + ay * dy
    hxx = (1.0 + 2.0 * ay * gx + k * gx * gx) / d
    hxy = (ay * gy - ax * gx + k * gx * gy) / d
    hyy = (1.0 - 2.0 * ax * gy + k * gy * gy) / d
    return theta, gx, gy, hxx, hxy, hyy
