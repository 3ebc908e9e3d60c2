"""The stage before its first sample, and after a turn no sensor has felt."""

from math import inf

from estimator.conditioning.averaging import USUAL_AVERAGING
from estimator.conditioning.gather import NOTHING
from estimator.conditioning.spin import SCALE_SIGMA
from estimator.conditioning.types import (
    Axes,
    Calibration,
    CalibrationMeans,
    CalibrationState,
    Certainty,
    Clipping,
    Coefficients,
    ConditioningParams,
    ConditioningState,
    Doubt,
    Estimate,
    FieldBefore,
    FieldLook,
    FieldReference,
    FieldRival,
    Force,
    GravitySigns,
    GravityState,
    HeadingSigns,
    JumpSigns,
    Lagged,
    LowPass,
    MagneticState,
    RestState,
    Rows,
    Smooth,
    Spin,
    TiltState,
    TurnSigns,
)
from estimator.geometry.quaternion import multiply, normalize, rotate_inverse
from estimator.types import IDENTITY, Quaternion

ZERO = (0.0, 0.0, 0.0)
SIX = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
USUAL_SCATTER = 1.5e-4  # rad^2: a field that points 0.7 degrees off
UNKNOWN_WANDER = 0.03  # rad^2: accelerations that tilt the mean force of a second by ten degrees
NO_SPIN = Spin(turn=Smooth(ZERO, ZERO), scale_error=0.0, variance=SCALE_SIGMA**2, drift_rad_s=ZERO)
UNKNOWN_HEADING_VARIANCE = 1e4  # rad^2, beyond any angle: the first field sets the heading


def initial_state(params: ConditioningParams) -> ConditioningState:
    """The state before the first sample."""
    bias = params.bias_initial_sigma_rad_s**2
    offset = params.field_offset_sigma**2 if params.use_field_offset else 0.0
    lag = params.field_lag_sigma_s**2 if params.use_lag else 0.0
    still = LowPass(0.0, 0.0, 0.0, 0.0)
    return ConditioningState(
        started=False,
        previous_gyr_rad_s=ZERO,
        gathered=NOTHING,
        clipping=Clipping(peak_rad_s=ZERO, run_s=ZERO, missed=ZERO),
        spin=NO_SPIN,
        gravity=GravityState(
            q_g_frd=IDENTITY,
            q_6d_g=IDENTITY,
            force=Force(down=Smooth(ZERO, ZERO), quick=ZERO, unsteady=0.0, age_s=0.0),
        ),
        tilt=TiltState(
            variance=0.0,
            scatter=0.0,
            tilting=0.0,
            twisting=0.0,
            gyr=ZERO,
            force_g=ZERO,
            force=0.0,
        ),
        rest=RestState(
            gyr=Smooth(ZERO, ZERO),
            acc=Smooth(ZERO, ZERO),
            quiet=False,
            quiet_s=0.0,
            resting=False,
        ),
        estimate=Estimate(
            bias_rad_s=ZERO,
            heading_rad=0.0,
            covariance=(bias, 0.0, 0.0, 0.0, bias, 0.0, 0.0, bias, 0.0, UNKNOWN_HEADING_VARIANCE),
        ),
        lagged=Lagged(rows=SIX, rows_slope=SIX, drift=(0.0, 0.0), drift_slope=(0.0, 0.0)),
        averaging=USUAL_AVERAGING,
        magnetic=MagneticState(
            look=FieldLook(horizontal=0.0, down=0.0, confidence=0.0),
            reference=FieldReference(
                horizontal=0.0,
                down=0.0,
                samples=0.0,
                age_s=0.0,
                borne_s=0.0,
                other=FieldRival(horizontal=0.0, down=0.0, seen_s=0.0),
                is_new=False,
                uneven=0.0,
            ),
            wait_s=0.0,
            known=False,
        ),
        calibration=CalibrationState(
            learnt=Calibration(
                lag_s=0.0,
                offset=ZERO,
                covariance=(offset, 0.0, 0.0, 0.0, offset, 0.0, 0.0, offset, 0.0, lag),
                scale=0.0,
            ),
            means=CalibrationMeans(
                field=ZERO,
                turning=ZERO,
                rows=Rows(ZERO, ZERO, ZERO),
            ),
            age_s=0.0,
            started=False,
        ),
        signs=TurnSigns(
            heading=HeadingSigns(
                mean_north=0.0,
                mean_east=0.0,
                mean_confidence=0.0,
                off_s=0.0,
                large_s=0.0,
                scatter=USUAL_SCATTER,
                borne_s=0.0,
                other_rad=0.0,
                other_s=0.0,
            ),
            gravity=GravitySigns(
                quiet_s=0.0, moving_s=0.0, levelled=(0.0, 0.0), wander=UNKNOWN_WANDER, uneven=0.0
            ),
            jump=JumpSigns(
                quick=ZERO,
                slow=ZERO,
                quick_norm=0.0,
                slow_norm=0.0,
                apart_rad=0.0,
                usual=0.0,
                usual_turning=0.0,
                turning=0.0,
                unseen=0.0,
                seen_rad=0.0,
                ahead_rad=0.0,
                age_s=0.0,
            ),
        ),
        doubt=Doubt(tilt=0.0, heading=0.0, usual_s=0.0, before=FieldBefore(0.0, 0.0)),
        axes=Axes(down_g=(0.0, 0.0, 1.0), north_g=(1.0, 0.0, 0.0)),
        certainty=Certainty(
            weight=1.0,
            has_heading=False,
            gravity_confidence=0.0,
            magnetic_confidence=0.0,
            sigma_inclination_rad=0.0,
            sigma_heading_rad=inf,
        ),
        coefficients=Coefficients(
            dt_s=0.0,
            factor=1.0,
            rest=still,
            gravity=still,
            gravity_share=0.0,
            quick_share=0.0,
            levelling_decay=0.0,
            bias_growth=0.0,
            rest_noise=0.0,
            motion_noise=0.0,
            heading_growth=0.0,
        ),
    )


def forget_bias(params: ConditioningParams, state: ConditioningState) -> ConditioningState:
    """The same attitude, from another gyroscope: its errors are as at the beginning."""
    bias = params.bias_initial_sigma_rad_s**2
    estimate = state.estimate
    heading = estimate.covariance[9]
    return state._replace(
        spin=NO_SPIN,
        estimate=Estimate(
            bias_rad_s=ZERO,
            heading_rad=estimate.heading_rad,
            covariance=(bias, 0.0, 0.0, 0.0, bias, 0.0, 0.0, bias, 0.0, heading),
        ),
    )


def apply_turn(state: ConditioningState, turn_frd: Quaternion) -> ConditioningState:
    """Every attitude inside turned by one body rotation, as if the vehicle had turned unfelt."""
    gravity = state.gravity
    q = normalize(multiply(gravity.q_g_frd, turn_frd))
    r = state.lagged.rows
    north = rotate_inverse(turn_frd, r[:3])
    east = rotate_inverse(turn_frd, r[3:])
    calibration = state.calibration
    mean = calibration.means.rows
    rows = Rows(
        rotate_inverse(turn_frd, mean.north),
        rotate_inverse(turn_frd, mean.east),
        rotate_inverse(turn_frd, mean.down),
    )
    return state._replace(
        gravity=gravity._replace(q_g_frd=q),
        lagged=state.lagged._replace(rows=(*north, *east)),
        calibration=calibration._replace(means=calibration.means._replace(rows=rows)),
    )
