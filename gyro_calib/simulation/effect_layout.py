"""Layout of the numbers and of the memory that the effect kernels take."""

from __future__ import annotations

__all__ = ["N_EFFECT", "N_MEMORY", "N_ROW"]

# forces per mass: |v|^2 v, v_x^3, v_y^3 [s/m^2], |v| v [1/m], v/|v| [m/s^2]; whether the loops are closed; relaxation [1/s^2], its decay
# per control period
E_VELOCITY, E_VELOCITY_X, E_VELOCITY_Y, E_DRAG, E_FRICTION, E_CLOSED, E_RELAX, E_RELAX_KEEP = 0, 1, 2, 3, 4, 5, 7, 8
# drive as phasor: constant x_c, x_s, y_c, y_s [V], sag [1/V^2], phase of x and y [rad/V^2], lag: decay and mean over a control period,
# memory: share, decay and mean over a control period
E_CONSTANT, E_SAG, E_PHASE_X, E_PHASE_Y, E_LAG_KEEP, E_LAG_MEAN, E_SLOW, E_SLOW_KEEP, E_SLOW_MEAN = 9, 13, 14, 15, 16, 17, 18, 19, 20
# drive per sample: cubic of x, y, across [1/V^2], clip, dead zone, step [V]
E_CUBIC_X, E_CUBIC_Y, E_CROSS, E_CLIP, E_DEAD, E_STEP = 21, 22, 23, 24, 25, 26
# spurious modes: half-width [rad/s]; tone: angular frequency [rad/s], x, y [V], phase [rad]
E_MODE_HALF, E_TONE_OMEGA, E_TONE_X, E_TONE_Y, E_TONE_PHASE = 27, 28, 29, 30, 31
# pick-off: interference x_c, x_s, y_c, y_s [V], phase of x and y [rad/V^2], cubic across [1/V^2], hum: angular frequency [rad/s], x, y [V]
E_STRAY, E_READ_X, E_READ_Y, E_READ_CROSS, E_HUM_OMEGA, E_HUM_X, E_HUM_Y = 32, 36, 37, 38, 39, 40, 41
# pick-off after the demodulator: decay of the lag, memory: share and decay per control period, decay and lead of the skew; gain noise per
# control period; control period [s]; factor by which a zero-order hold lowers what it holds
E_OUT_KEEP, E_OUT_SLOW, E_OUT_SLOW_KEEP, E_SKEW_KEEP, E_SKEW_LEAD, E_GAIN, E_PERIOD, E_HOLD = 42, 43, 44, 45, 46, 47, 48, 49
# gains of the spurious modes: of the x drive in the x pick-off, of y in x, of x in y, of y in y [1/s]
E_MODE_XX, E_MODE_XY, E_MODE_YX, E_MODE_YY = 50, 51, 52, 53
# stiffness per drive volt squared of x and of y [1/s^2/V^2]; per amplitude squared
E_SOFT_X, E_SOFT_Y, E_MEAN_X, E_MEAN_Y = 54, 55, 75, 76
# delay of the carriers over a control period, x and y; nominal angular frequency [rad/s]
E_DELAY_X, E_DELAY_Y, E_NOMINAL = 56, 57, 58
# the same of the drives
E_LATE_X, E_LATE_Y = 59, 60
# friction of each axis [m/s^2]
E_FRICTION_X, E_FRICTION_Y = 61, 62
# parametric pump: cos and sin of x, of y [1/s^2], and per volt of the amplitude loop's command [1/s^2/V]
E_PUMP, E_DRIVEN_PUMP = 63, 67
# spur of the reference: its phase [rad] and angular frequency [rad/s]
E_SPUR, E_SPUR_OMEGA = 71, 72
# gain of the drives by the squared motion of x and of y [1/V^2]
E_GAP_X, E_GAP_Y = 73, 74
# circulatory stiffness [1/s^2]
E_CURL = 77
# of axes that are turned: v_x^3 v_y, v_x v_y^3 and v_x^2 v_y^2/2 [s/m^2]
E_VELOCITY_XY, E_VELOCITY_YX, E_VELOCITY_XXYY = 78, 79, 80
N_EFFECT = 81

# memory: time [s]; lagged and slow drive x_c, x_s, y_c, y_s [V]; slow displacement x_c, x_s, y_c, y_s [m]; spurious modes of the x and of
# the y drive, re, im [V s]; lagged and slow pick-off, last and lagged y pick-off c, s [V]; last undelayed
# pick-offs and drives x_c, x_s, y_c, y_s [V]
M_TIME, M_LAG, M_SLOW, M_MOTION, M_MODE, M_OUT_LAG, M_OUT_SLOW, M_LAST, M_SKEW, M_EARLY, M_SOON = 0, 1, 5, 9, 13, 17, 21, 25, 27, 29, 33
N_MEMORY = 37

# per row: feedthrough added, re, im of xx, xy, yx, yy; angular frequency of the spurious mode [rad/s]
R_FEED, R_MODE_OMEGA = 0, 8
N_ROW = 9
