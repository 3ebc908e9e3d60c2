"""The stage before its first sample, and after a turn no sensor has felt."""

from estimator.conditioning.gather import NOTHING
from estimator.conditioning.types import (
    Axes,
    CalibrationState,
    Coefficients,
    ConditioningParams,
    ConditioningState,
    Estimate,
    GravityState,
    Lagged,
    LowPass,
    MagneticState,
    RestState,
    Rows,
    Smooth,
    TiltState,
    TurnSigns,
)
from estimator.geometry.quaternion import multiply, normalize, rotate_inverse
from estimator.types import IDENTITY, Quaternion

ZERO = (0.0, 0.0, 0.0)
SIX = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
UNKNOWN_HEADING_VARIANCE = 1e4  # rad^2, beyond any angle: the first field sets the heading


def initial_state(params: ConditioningParams) -> ConditioningState:
    """The state before the first sample."""
    bias = params.bias_initial_sigma_rad_s**2
    offset = params.field_offset_sigma**2 if params.use_field_offset else 0.0
    lag = params.field_lag_sigma_s**2 if params.use_lag else 0.0
    still = LowPass(0.0, 0.0, 0.0)
    return ConditioningState(
        started=False,
        previous_gyr_rad_s=ZERO,
        gathered=NOTHING,
        gravity=GravityState(IDENTITY, IDENTITY, Smooth(ZERO, ZERO), ZERO, 0.0, 0.0),
        tilt=TiltState(0.0, 0.0, 0.0, 0.0, ZERO, ZERO, 0.0),
        rest=RestState(Smooth(ZERO, ZERO), Smooth(ZERO, ZERO), False, 0.0, False),
        estimate=Estimate(
            ZERO,
            0.0,
            (bias, 0.0, 0.0, 0.0, bias, 0.0, 0.0, bias, 0.0, UNKNOWN_HEADING_VARIANCE),
        ),
        lagged=Lagged(SIX, SIX, (0.0, 0.0), (0.0, 0.0)),
        magnetic=MagneticState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False),
        calibration=CalibrationState(
            0.0,
            ZERO,
            (offset, 0.0, 0.0, 0.0, offset, 0.0, 0.0, offset, 0.0, lag),
            0.0,
            ZERO,
            ZERO,
            Rows(ZERO, ZERO, ZERO),
            False,
        ),
        signs=TurnSigns(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0)),
        axes=Axes((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
        coefficients=Coefficients(0.0, still, still, 0.0, 0.0, 0.0, 0.0, 0.0),
    )


def forget_bias(params: ConditioningParams, state: ConditioningState) -> ConditioningState:
    """The same attitude, from another gyroscope: its bias is as at the beginning."""
    bias = params.bias_initial_sigma_rad_s**2
    estimate = state.estimate
    heading = estimate.covariance[9]
    return state._replace(
        estimate=Estimate(
            ZERO,
            estimate.heading_rad,
            (bias, 0.0, 0.0, 0.0, bias, 0.0, 0.0, bias, 0.0, heading),
        )
    )


def apply_turn(state: ConditioningState, turn_frd: Quaternion) -> ConditioningState:
    """Every attitude inside turned by one body rotation, as if the vehicle had turned unfelt."""
    gravity = state.gravity
    q = normalize(multiply(gravity.q_g_frd, turn_frd))
    r = state.lagged.rows
    north = rotate_inverse(turn_frd, r[:3])
    east = rotate_inverse(turn_frd, r[3:])
    mean = state.calibration.mean_rows
    rows = Rows(
        rotate_inverse(turn_frd, mean.north),
        rotate_inverse(turn_frd, mean.east),
        rotate_inverse(turn_frd, mean.down),
    )
    return state._replace(
        gravity=gravity._replace(q_g_frd=q),
        lagged=state.lagged._replace(rows=(*north, *east)),
        calibration=state.calibration._replace(mean_rows=rows),
    )
