"""What a magnetic field sample says about the heading, the hard iron and the field's lag."""

from math import atan2, sqrt

import numpy as np

from estimator.aiding.covariance import learn, rotation_matrix
from estimator.aiding.types import (
    FIELD_LAG,
    HARD_IRON,
    SIZE,
    TURN,
    AidingParams,
    Array,
    Calibration,
    FieldState,
    Two,
)
from estimator.compiled import inlined
from estimator.conditioning.magnetic import LEAST_HORIZONTAL
from estimator.quaternion import add, cross, rotate, scale, subtract
from estimator.types import Quaternion, Vec3

FIELD_TAU_S = 0.05  # low-pass of norm and dip
RESIDUAL_TAU_S = 5.0
RESIDUAL_MEMORY_S = 60.0
RESIDUAL_CLIP_RAD = 0.2
LEAST_CONFIDENCE = 1e-6
FIRST_WAIT_S = 0.1


@inlined
def without_field(state: FieldState, dt: float) -> FieldState:
    """Only time passes."""
    return FieldState(
        state.horizontal_reference,
        state.down_reference,
        state.horizontal,
        state.down,
        state.samples,
        state.age_s,
        state.wait_s + dt,
        state.confidence,
        state.residual_rad,
        state.residual_square,
        state.doubt_s,
    )


@inlined
def judged(params: AidingParams, state: FieldState, h: float, v: float) -> FieldState:
    """Norm and dip against their learnt references, as for the unaided field.

    D^2 = ((n - n_r)/(s_n n_r))^2 + (sin(d - d_r)/s_d)^2, c = 1/(1 + D^2)^2.
    """
    samples = state.samples + 1.0
    age = state.age_s + state.wait_s
    if state.samples == 0.0:
        return FieldState(h, v, h, v, samples, age, 0.0, 1.0, 0.0, 0.0, 0.0)
    wait = min(state.wait_s, 1.0)
    a = wait / (FIELD_TAU_S + wait)
    smooth_h = state.horizontal + a * (h - state.horizontal)
    smooth_v = state.down + a * (v - state.down)
    h_r, v_r = state.horizontal_reference, state.down_reference
    n = sqrt(smooth_h * smooth_h + smooth_v * smooth_v)
    n_r = sqrt(h_r * h_r + v_r * v_r)
    off_norm = (n - n_r) / (params.field_norm_scale * n_r)
    off_dip = (smooth_v * h_r - smooth_h * v_r) / (params.field_dip_scale_rad * n * n_r)
    confidence = 1.0 / (1.0 + off_norm * off_norm + off_dip * off_dip) ** 2
    weight = min(1.0, wait / params.field_reference_tau_s) * confidence
    if age < params.field_reference_tau_s:
        weight = max(weight, 1.0 / samples)
    return FieldState(
        h_r + weight * (h - h_r),
        v_r + weight * (v - v_r),
        smooth_h,
        smooth_v,
        samples,
        age,
        0.0,
        confidence,
        state.residual_rad,
        state.residual_square,
        state.doubt_s,
    )


@inlined
def observe_heading(
    params: AidingParams,
    field: FieldState,
    calibration: Calibration,
    q_ned_frd: Quaternion,
    north: Two,
    gyr: Vec3,
    mag: Vec3,
    P: Array,
    x: Array,
) -> FieldState:
    """One scalar update: the field's east part, seen from magnetic north, is zero.

    ``north`` is magnetic north as (north, east). The reading is ``lag`` old, so
    the body's turn since then is undone first: m <- m - lag w x m + .... The
    east part changes by (turn x F)_east with the attitude, so dip lets a tilt
    error in and the covariance knows; by -(R offset)_east with the hard iron.
    """
    c, s = north
    rate = subtract(gyr, calibration.gyr_bias_rad_s)
    m = subtract(mag, calibration.hard_iron_gauss)
    lag = calibration.lag_s
    moved = cross(rate, m)
    m = add(subtract(m, scale(lag, moved)), scale(0.5 * lag * lag, cross(rate, moved)))
    F = rotate(q_ned_frd, m)
    dF = rotate(q_ned_frd, moved)
    F_north, F_east, F_down = c * F[0] + s * F[1], c * F[1] - s * F[0], F[2]
    wait = FIRST_WAIT_S if field.samples == 0.0 else min(field.wait_s, 1.0)
    field = judged(params, field, sqrt(F_north * F_north + F_east * F_east), F_down)
    h_r = field.horizontal_reference
    if h_r <= LEAST_HORIZONTAL * abs(field.down_reference) or wait <= 0.0:
        return field
    h = np.zeros(SIZE)
    h[TURN + 2] = 1.0
    if F_north > 0.5 * abs(F_east):
        off = -F_east / h_r
        h[TURN] = -c * F_down / h_r
        h[TURN + 1] = -s * F_down / h_r
        h[FIELD_LAG] = (s * dF[0] - c * dF[1]) / h_r
        R = rotation_matrix(q_ned_frd)
        for j in range(3):
            h[HARD_IRON + j] = (s * R[0, j] - c * R[1, j]) / h_r
    else:
        off = -atan2(F_east, F_north)
    learn(P, x, h, off, params.heading_noise**2 / (wait * max(field.confidence, LEAST_CONFIDENCE)))
    far = abs(atan2(F_east, F_north)) > params.far_heading_rad
    return remembered(field, off, far, wait)


@inlined
def remembered(field: FieldState, off: float, far: bool, wait: float) -> FieldState:
    """The slow part of the residual: noise averages out, a wrong field does not."""
    clipped = max(-RESIDUAL_CLIP_RAD, min(RESIDUAL_CLIP_RAD, off))
    slow = field.residual_rad
    slow += wait / (wait + RESIDUAL_TAU_S) * (clipped - slow)
    share = max(wait / (wait + RESIDUAL_MEMORY_S), 1.0 / field.samples)
    square = field.residual_square + share * (slow * slow - field.residual_square)
    return FieldState(
        field.horizontal_reference,
        field.down_reference,
        field.horizontal,
        field.down,
        field.samples,
        field.age_s,
        field.wait_s,
        field.confidence,
        slow,
        square,
        field.doubt_s + wait if far else max(0.0, field.doubt_s - wait),
    )
