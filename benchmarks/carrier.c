/* The carrier loop of gyro_calib/simulation/carrier.py in C, for speed comparison only: the same work on the same arrays in the same order.
 * State and parameters of the control law as in gyro_calib/simulation/control.py. */
#include <math.h>
#include <string.h>

enum { S_PHASE, S_OMEGA, S_PLL, S_AMP, S_REB_C, S_REB_S, S_TIME, S_DRIVE, S_BODY = 11 };
enum { P_MODE, P_AMPLITUDE, P_EXCITATION, P_FREQUENCY, P_INDEX, P_VOLTS, P_AXIS, P_OMEGA, P_PLL_KP, P_PLL_KI, P_AMP_KP, P_AMP_KI,
       P_REB_KP, P_REB_KI, P_FULL_SCALE, P_COMP, P_PERIOD = 19 };
enum { FTR_X, FTR_Y, LOOPS_OFF };
enum { EXC_NONE, EXC_AMPLITUDE, EXC_FREQUENCY, EXC_SECONDARY, EXC_DRIVE, EXC_BODY };
enum { FLAG_NONLINEAR = 1, FLAG_CONVERTERS = 2, FLAG_PICKOFF_CUBIC = 4 };
#define MAX_SAMPLES 256
#define MAX_CONTROLS 256
#define TERMS 18
static const double TWO_PI = 6.283185307179586476925286766559;

static double clip(double value, double limit) { return value > limit ? limit : value < -limit ? -limit : value; }

static double converter(double value, double full_scale, double lsb)
{
    if (lsb > 0.0)
        value = lsb * floor(value / lsb + 0.5);
    return clip(value, full_scale);
}

static void control_step(double *state, const double *param, double xc, double xs, double yc, double ys)
{
    const int mode = (int)param[P_MODE], excitation = (int)param[P_EXCITATION];
    const double period = param[P_PERIOD], full = param[P_FULL_SCALE], t = state[S_TIME];
    double uxc = 0.0, uxs = 0.0, uyc = 0.0, uys = 0.0;
    state[S_BODY] = 0.0;
    if (mode == LOOPS_OFF) {
        state[S_OMEGA] = TWO_PI * param[P_FREQUENCY];
        if (excitation == EXC_DRIVE) {
            if ((int)param[P_AXIS] == 0)
                uxc = param[P_VOLTS];
            else
                uyc = param[P_VOLTS];
        } else if (excitation == EXC_BODY) {
            state[S_BODY] = param[P_VOLTS];
        }
    } else {
        const double oc = mode == FTR_X ? xc : yc, os = mode == FTR_X ? xs : ys;
        double cc = mode == FTR_X ? yc : xc;
        const double cs = mode == FTR_X ? ys : xs;
        const double wave = excitation >= EXC_AMPLITUDE && excitation <= EXC_SECONDARY ? sin(TWO_PI * param[P_FREQUENCY] * t) : 0.0;
        double target = param[P_AMPLITUDE];
        if (excitation == EXC_AMPLITUDE)
            target *= 1.0 + param[P_INDEX] * wave;
        double error = oc * oc + os * os > 0.04 * param[P_AMPLITUDE] * param[P_AMPLITUDE] ? atan2(os, oc) : 0.0;
        if (excitation == EXC_FREQUENCY)
            error -= param[P_INDEX] * wave;
        state[S_PLL] = clip(state[S_PLL] + param[P_PLL_KI] * error * period, 0.01 * param[P_OMEGA]);
        state[S_OMEGA] = param[P_OMEGA] + state[S_PLL] + param[P_PLL_KP] * error;
        const double lack = target - oc;
        double along = param[P_AMP_KP] * lack + state[S_AMP];
        if (fabs(along) < full)
            state[S_AMP] += param[P_AMP_KI] * lack * period;
        along = clip(along, full);
        if (excitation == EXC_SECONDARY)
            cc -= param[P_AMPLITUDE] * param[P_INDEX] * wave;
        const double re = param[P_REB_KP] * cc + state[S_REB_C], im = param[P_REB_KP] * cs + state[S_REB_S];
        if (fabs(re) < full && fabs(im) < full) {
            state[S_REB_C] += param[P_REB_KI] * cc * period;
            state[S_REB_S] += param[P_REB_KI] * cs * period;
        }
        const double bc = clip(im, full), bs = clip(-re, full);
        if (mode == FTR_X) {
            uxs = along, uyc = bc, uys = bs;
        } else {
            uxc = bc, uxs = bs, uys = along;
        }
    }
    const double *comp = param + P_COMP;
    state[S_DRIVE] = comp[0] * uxc + comp[1] * uyc;
    state[S_DRIVE + 1] = comp[0] * uxs + comp[1] * uys;
    state[S_DRIVE + 2] = comp[2] * uxc + comp[3] * uyc;
    state[S_DRIVE + 3] = comp[2] * uxs + comp[3] * uys;
    state[S_TIME] = t + period;
}

static void instant_force(double x, double y, double vx, double vy, const double *c, double *fx, double *fy)
{
    const double square = x * x + y * y;
    *fx = (c[0] * square + c[1] * x * x) * x + c[3] * y * y * y + c[5] * square * vx;
    *fy = (c[0] * square + c[2] * y * y) * y + c[4] * x * x * x + c[5] * square * vy;
}

static void exact_propagator(const double *p, double w, double dt, double phi[4][4], double gamma[4][2])
{
    const double m[4][4] = {{0.0, 0.0, w * dt, 0.0},
                            {0.0, 0.0, 0.0, w * dt},
                            {-p[0] / w * dt, -p[1] / w * dt, -p[3] * dt, -p[4] * dt},
                            {-p[1] / w * dt, -p[2] / w * dt, -p[5] * dt, -p[6] * dt}};
    double term[4][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}}, integral[4][4], next[4][4];
    memcpy(phi, term, sizeof term);
    memcpy(integral, term, sizeof term);
    for (int k = 1; k < TERMS; k++) {
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 4; j++) {
                double total = 0.0;
                for (int q = 0; q < 4; q++)
                    total += term[i][q] * m[q][j];
                next[i][j] = total / k;
            }
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 4; j++) {
                term[i][j] = next[i][j];
                phi[i][j] += next[i][j];
                integral[i][j] += next[i][j] / (k + 1);
            }
    }
    for (int i = 0; i < 4; i++) {
        gamma[i][0] = integral[i][2] * dt / w;
        gamma[i][1] = integral[i][3] * dt / w;
    }
}

/* steps[controls][9], weights row_w[2][3][controls], acc[2][9] */
static void emit_row(double steps[][9], int controls, const double *row_w, double *acc, double *out)
{
    double sum[3][9];
    memcpy(sum[0], acc, sizeof sum[0]);
    memcpy(sum[1], acc + 9, sizeof sum[1]);
    memset(sum[2], 0, sizeof sum[2]);
    for (int j = 0; j < controls; j++)
        for (int k = 0; k < 3; k++) {
            const double pick = row_w[k * controls + j], rest = row_w[(3 + k) * controls + j];
            for (int q = 0; q < 4; q++)
                sum[k][q] += pick * steps[j][q];
            for (int q = 4; q < 9; q++)
                sum[k][q] += rest * steps[j][q];
        }
    memcpy(out, sum[0], sizeof sum[0]);
    memcpy(acc, sum[1], sizeof sum[1]);
    memcpy(acc + 9, sum[2], sizeof sum[2]);
}

/* Arguments as gyro_calib.simulation.carrier.carrier_rows, then the sizes; 0, or -1 when the sizes are beyond the buffers. */
int carrier_rows(double *z, double *loop, const double *param, double *adc_acc, double *row_acc, const double *adc_w, const double *row_w,
                 const double *physics, const double *drive, const double *pick, const double *feed, double body, const double *nonlinear,
                 const double *converters, const double *constants, long flags, const float *noise, double *out, long rows, long samples,
                 long controls)
{
    if (samples > MAX_SAMPLES || controls > MAX_CONTROLS)
        return -1;
    const double dt = constants[0], w = constants[1], pick_noise = constants[2], half_kick = -0.5 * dt / w;
    double phi[4][4], gamma[4][2], steps[MAX_CONTROLS][9], volts[MAX_SAMPLES][4];
    double x = z[0], y = z[1], vx = z[2], vy = z[3], phase = loop[S_PHASE];
    for (long row = 0; row < rows; row++) {
        const double *p = physics + 8 * row, *b = drive + 8 * row, *pk = pick + 8 * row;
        const double kick = p[7];
        if (z[4] != 0.0) { /* a stiffness that moves does so smoothly: keep phase and action */
            const double q = 0.25 / (w * w), d11 = q * (p[0] - z[4]), d12 = q * (p[1] - z[5]), d22 = q * (p[2] - z[6]);
            const double x0 = x, y0 = y, vx0 = vx, vy0 = vy;
            x = x0 - (d11 * x0 + d12 * y0), y = y0 - (d12 * x0 + d22 * y0);
            vx = vx0 + (d11 * vx0 + d12 * vy0), vy = vy0 + (d12 * vx0 + d22 * vy0);
        }
        z[4] = p[0], z[5] = p[1], z[6] = p[2];
        exact_propagator(p, w, dt, phi, gamma);
        for (long step = 0; step < controls; step++) {
            const double omega = loop[S_OMEGA], push = loop[S_BODY];
            const double uxc = loop[S_DRIVE], uxs = loop[S_DRIVE + 1], uyc = loop[S_DRIVE + 2], uys = loop[S_DRIVE + 3];
            const double ca = cos(0.5 * omega * dt), sa = sin(0.5 * omega * dt);
            const double axr = uxc * ca - uxs * sa, axi = uxc * sa + uxs * ca, ayr = uyc * ca - uys * sa, ayi = uyc * sa + uys * ca;
            const double fxr = b[0] * axr - b[1] * axi + b[2] * ayr - b[3] * ayi + body * push * ca;
            const double fxi = b[0] * axi + b[1] * axr + b[2] * ayi + b[3] * ayr + body * push * sa;
            const double fyr = b[4] * axr - b[5] * axi + b[6] * ayr - b[7] * ayi + body * push * ca;
            const double fyi = b[4] * axi + b[5] * axr + b[6] * ayi + b[7] * ayr + body * push * sa;
            const double exr = feed[0] * uxc - feed[1] * uxs + feed[2] * uyc - feed[3] * uys;
            const double exi = feed[0] * uxs + feed[1] * uxc + feed[2] * uys + feed[3] * uyc;
            const double eyr = feed[4] * uxc - feed[5] * uxs + feed[6] * uyc - feed[7] * uys;
            const double eyi = feed[4] * uxs + feed[5] * uxc + feed[6] * uys + feed[7] * uyc;
            const double turn_c = cos(omega * dt), turn_s = sin(omega * dt);
            double c = cos(phase), s = sin(phase);
            for (long j = 0; j < samples; j++, noise += 4) {
                double voltx = ((pk[0] * x + pk[1] * vx) + (pk[2] * y + pk[3] * vy)) + (exr * c - exi * s + pick_noise * noise[2]);
                double volty = ((pk[4] * x + pk[5] * vx) + (pk[6] * y + pk[7] * vy)) + (eyr * c - eyi * s + pick_noise * noise[3]);
                if (flags & FLAG_PICKOFF_CUBIC) {
                    voltx += converters[4] * voltx * voltx * voltx;
                    volty += converters[7] * volty * volty * volty;
                }
                if (flags & FLAG_CONVERTERS) {
                    voltx = converter(voltx, converters[0], converters[1]);
                    volty = converter(volty, converters[0], converters[1]);
                }
                volts[j][0] = 2.0 * voltx * c, volts[j][1] = -2.0 * voltx * s, volts[j][2] = 2.0 * volty * c, volts[j][3] = -2.0 * volty * s;
                const double forcex = fxr * c - fxi * s, forcey = fyr * c - fyi * s;
                double kx, ky;
                if (flags & FLAG_NONLINEAR) {
                    instant_force(x, y, vx * w, vy * w, nonlinear, &kx, &ky);
                    vx += half_kick * kx, vy += half_kick * ky;
                }
                const double x1 = ((phi[0][0] * x + phi[0][1] * y) + (phi[0][2] * vx + phi[0][3] * vy)) + (gamma[0][0] * forcex + gamma[0][1] * forcey);
                const double y1 = ((phi[1][0] * x + phi[1][1] * y) + (phi[1][2] * vx + phi[1][3] * vy)) + (gamma[1][0] * forcex + gamma[1][1] * forcey);
                const double vx1 = ((phi[2][0] * x + phi[2][1] * y) + (phi[2][2] * vx + phi[2][3] * vy))
                                   + (gamma[2][0] * forcex + gamma[2][1] * forcey + kick * noise[0]);
                const double vy1 = ((phi[3][0] * x + phi[3][1] * y) + (phi[3][2] * vx + phi[3][3] * vy))
                                   + (gamma[3][0] * forcex + gamma[3][1] * forcey + kick * noise[1]);
                x = x1, y = y1, vx = vx1, vy = vy1;
                if (flags & FLAG_NONLINEAR) {
                    instant_force(x, y, vx * w, vy * w, nonlinear, &kx, &ky);
                    vx += half_kick * kx, vy += half_kick * ky;
                }
                const double c1 = c * turn_c - s * turn_s;
                s = s * turn_c + c * turn_s;
                c = c1;
            }
            phase = fmod(phase + omega * dt * samples, TWO_PI);
            double sum[3][4] = {{0.0}};
            memcpy(sum, adc_acc, 8 * sizeof(double));
            for (long j = 0; j < samples; j++)
                for (int k = 0; k < 3; k++)
                    for (int q = 0; q < 4; q++)
                        sum[k][q] += adc_w[k * samples + j] * volts[j][q];
            memcpy(adc_acc, sum[1], 8 * sizeof(double));
            double *line = steps[step];
            memcpy(line, sum[0], 4 * sizeof(double));
            line[4] = uxc, line[5] = uxs, line[6] = uyc, line[7] = uys, line[8] = omega;
            control_step(loop, param, sum[0][0], sum[0][1], sum[0][2], sum[0][3]);
        }
        emit_row(steps, (int)controls, row_w, row_acc, out + 9 * row);
    }
    z[0] = x, z[1] = y, z[2] = vx, z[3] = vy;
    loop[S_PHASE] = phase;
    return 0;
}
