"""Quaternion and SO(3) algebra on plain tuples, compiled.

Hamilton product, scalar first. ``q_ab`` rotates coordinates from frame b to
frame a: ``v_a = rotate(q_ab, v_b)`` and ``q_ac = multiply(q_ab, q_bc)``.

Source of the identities: J. Solà, "Quaternion kinematics for the error-state
Kalman filter", arXiv:1711.02508.
"""

from math import acos, atan2, cos, pi, sin, sqrt

from estimator.compilation.compiled import inlined
from estimator.types import Quaternion, Vec3

# Below these half angles (rad) the next term is under 1e-15: of the exponential's series of four
# terms, which spares small steps the sine and cosine, and of the logarithm's of two.
SERIES_HALF_ANGLE_RAD = 0.05
SMALL_HALF_ANGLE_RAD = 1e-4
# Below this squared sine of half an angle the eighth term of the arcsine's series is under 1e-17.
SERIES_HALF_SINE_SQUARE = 0.01
# A squared norm this near to one differs by rounding only: its inverse root is a straight line.
NEARLY_UNIT = 1e-8
# asin(s)/s = 1 + k1 s^2 + k2 s^4 + ..., k_n = (2n)! / (4^n (n!)^2 (2n + 1)).
ARCSINE = (1 / 6, 3 / 40, 5 / 112, 35 / 1152, 63 / 2816, 231 / 13312, 143 / 10240)
# Below this tangent the seventh term of the arctangent's series is under 1e-18 of the angle:
# atan(t)/t = 1 - t^2/3 + t^4/5 - ...
SERIES_TANGENT = 0.05
ARCTANGENT = (1 / 3, 1 / 5, 1 / 7, 1 / 9, 1 / 11, 1 / 13)
# Factors of the exponential's series; a multiplication takes a quarter of a division's time.
SIXTH, TWELFTH, TWENTIETH, THIRTIETH, FORTY_SECOND = 1 / 6, 1 / 12, 1 / 20, 1 / 30, 1 / 42
# The mean square angle between a direction and any other one, rad^2: it is known no worse.
ANY_DIRECTION_VARIANCE = 0.5 * (pi**2 - 4.0)
# After a turn by an unknown angle any is possible: none is known worse than this, rad^2.
HALF_TURN_VARIANCE = pi**2


@inlined
def dot(u: Vec3, v: Vec3) -> float:
    """u . v."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inlined
def cross(u: Vec3, v: Vec3) -> Vec3:
    """u x v."""
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


@inlined
def add(u: Vec3, v: Vec3) -> Vec3:
    """u + v."""
    return (u[0] + v[0], u[1] + v[1], u[2] + v[2])


@inlined
def subtract(u: Vec3, v: Vec3) -> Vec3:
    """u - v."""
    return (u[0] - v[0], u[1] - v[1], u[2] - v[2])


@inlined
def scale(a: float, v: Vec3) -> Vec3:
    """a v."""
    return (a * v[0], a * v[1], a * v[2])


@inlined
def square(v: Vec3) -> float:
    """v . v, which compares lengths without a root."""
    return dot(v, v)


@inlined
def norm(v: Vec3) -> float:
    """|v|."""
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@inlined
def unit(v: Vec3) -> Vec3:
    """v / |v|; the zero vector stays zero."""
    n2 = dot(v, v)
    return scale(inverse_root(n2), v) if n2 > 0.0 else (0.0, 0.0, 0.0)


@inlined
def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product p q."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


@inlined
def conjugate(q: Quaternion) -> Quaternion:
    """The inverse of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


@inlined
def inverse_root(n2: float) -> float:
    """1/sqrt(n2), of a number above zero.

    Of what rounding alone keeps from one: 1/sqrt(1 + x) = 1 - x/2, and the next term is 3/8 x^2.
    """
    if abs(n2 - 1.0) < NEARLY_UNIT:
        return 1.5 - 0.5 * n2
    return 1.0 / sqrt(n2)


@inlined
def normalize(q: Quaternion) -> Quaternion:
    """q / |q|; the zero quaternion becomes the identity."""
    n2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if n2 == 0.0:
        return (1.0, 0.0, 0.0, 0.0)
    k = inverse_root(n2)
    return (k * q[0], k * q[1], k * q[2], k * q[3])


@inlined
def rotate(q: Quaternion, v: Vec3) -> Vec3:
    """q v q*: with ``q_ab`` and ``v_b`` this is ``v_a``."""
    # v + 2 r x (r x v + w v), r the vector part
    t0 = 2.0 * (q[2] * v[2] - q[3] * v[1])
    t1 = 2.0 * (q[3] * v[0] - q[1] * v[2])
    t2 = 2.0 * (q[1] * v[1] - q[2] * v[0])
    return (
        v[0] + q[0] * t0 + q[2] * t2 - q[3] * t1,
        v[1] + q[0] * t1 + q[3] * t0 - q[1] * t2,
        v[2] + q[0] * t2 + q[1] * t1 - q[2] * t0,
    )


@inlined
def rotate_inverse(q: Quaternion, v: Vec3) -> Vec3:
    """q* v q: with ``q_ab`` and ``v_a`` this is ``v_b`` (the paper's R^T v)."""
    return rotate((q[0], -q[1], -q[2], -q[3]), v)


@inlined
def exp(phi: Vec3) -> Quaternion:
    """Rotation vector (rad) to quaternion: (cos |phi|/2, sin(|phi|/2) phi/|phi|)."""
    x2 = 0.25 * (phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    if x2 < SERIES_HALF_ANGLE_RAD**2:
        # x the half angle: sin(x)/x = 1 - x^2/3! + x^4/5! - x^6/7!, and the cosine by its series
        k = 0.5 * (1.0 - x2 * SIXTH * (1.0 - x2 * TWENTIETH * (1.0 - x2 * FORTY_SECOND)))
        w = 1.0 - 0.5 * x2 * (1.0 - x2 * TWELFTH * (1.0 - x2 * THIRTIETH))
    else:
        x = sqrt(x2)
        k = 0.5 * sin(x) / x
        w = cos(x)
    return (w, k * phi[0], k * phi[1], k * phi[2])


@inlined
def log(q: Quaternion) -> Vec3:
    """Logarithm: unit quaternion to rotation vector (rad), the shorter way round (angle <= pi)."""
    s = 1.0 if q[0] >= 0.0 else -1.0  # q and -q are one rotation
    w = s * q[0]
    n = sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if n < SMALL_HALF_ANGLE_RAD:
        # 2 atan(n/w)/n = 2/w (1 - (n/w)^2/3)
        k = 2.0 / w * (1.0 - n * n / (3.0 * w * w))
    else:
        k = 2.0 * atan2(n, w) / n
    return (s * k * q[1], s * k * q[2], s * k * q[3])


@inlined
def direction(x: float, y: float) -> float:
    """The angle (rad, -pi..pi) of (x, y) from the first axis; of a small one by its series."""
    if abs(y) >= SERIES_TANGENT * x:
        return atan2(y, x)
    t = y / x
    z = t * t
    k1, k2, k3, k4, k5, k6 = ARCTANGENT
    z2 = z * z
    low = 1.0 - z * k1 + z2 * (k2 - z * k3)
    return t * (low + z2 * z2 * (k4 - z * k5 + z2 * k6))


@inlined
def angle_between(p: Quaternion, q: Quaternion) -> float:
    """Angle (rad, 0..pi) of the rotation p* q; p and -p are the same."""
    d = multiply(conjugate(p), q)
    n = sqrt(d[1] * d[1] + d[2] * d[2] + d[3] * d[3])
    return 2.0 * atan2(n, abs(d[0]))


@inlined
def shortest_rotation(u: Vec3, v: Vec3) -> Quaternion:
    """The smallest rotation that takes the direction of ``u`` to that of ``v`` (both non-zero)."""
    a = unit(u)
    b = unit(v)
    w = 1.0 + dot(a, b)
    c = cross(a, b)
    if w < 1e-12:
        # opposite directions: half a turn about any axis across u
        helper = (1.0, 0.0, 0.0) if abs(a[0]) < 0.9 else (0.0, 1.0, 0.0)
        axis = unit(cross(a, helper))
        return (0.0, axis[0], axis[1], axis[2])
    return normalize((w, c[0], c[1], c[2]))


@inlined
def normalized_distance(p: Quaternion, q: Quaternion) -> float:
    """The paper's |R~|_I = Tr(I - R^T R_hat)/4 = sin^2(angle/2), in [0, 1]."""
    d = multiply(conjugate(p), q)
    return min(1.0, d[1] * d[1] + d[2] * d[2] + d[3] * d[3])


@inlined
def angle_between_vectors(u: Vec3, v: Vec3) -> float:
    """Angle (rad, 0..pi) between two non-zero vectors.

    2 asin(s) with s = sqrt((1 - x)/2), the sine of half the angle, whose series serves small ones.
    """
    n2 = square(u) * square(v)
    x = max(-1.0, min(1.0, dot(u, v) / sqrt(n2) if n2 > 0.0 else 0.0))
    z = 0.5 * (1.0 - x)
    if z >= SERIES_HALF_SINE_SQUARE:
        return acos(x)
    k1, k2, k3, k4, k5, k6, k7 = ARCSINE
    z2 = z * z
    low = 1.0 + z * k1 + z2 * (k2 + z * k3)
    return 2.0 * sqrt(z) * (low + z2 * z2 * (k4 + z * k5 + z2 * (k6 + z * k7)))
