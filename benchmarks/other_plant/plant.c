/* Carrier-level plant of a two-mode Coriolis gyro with its sampled electronics.
 *
 * The nominal linear part (resonator, one pole per drive and per pick-off amplifier, feedthrough) is propagated exactly by a
 * matrix exponential over each sub-step, with the drive held by the converter.  What is slow, non-linear or random enters as
 * impulses between sub-steps.  Firmware (demodulator, loops, oscillator) runs in here too, once per window of R samples.
 *
 * State of the linear part: x y wx wy (w = velocity / w0), drive poles fx fy, feedthrough poles gx gy, pick-off poles px py.
 * Python reads the enums below, so their names are the only interface.  */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum Par { /* BEGIN PAR */
    P_H, P_M, P_R, P_W0, P_KAPPA, P_ADVANCE, P_DELAY_W, P_DAC_FS, P_ADC_FS, P_DAC_LSB, P_ADC_LSB, P_SIGMA_V, P_SIGMA_W,
    P_BODY_GAIN, P_BODY_PHASE, P_GNOM, P_ENV_HZ, P_PLL_HZ, P_AGC_HZ, P_REB_HZ, P_QUAD_HZ, P_SLOW_DT, P_UMAX, P_ALOCK,
    /* dynamics */
    P_DUF, P_DUFX, P_DUFY, P_CUBX, P_NLD, P_NLDX, P_NLDY, P_QUADD, P_COUL, P_COULX, P_COULY, P_NONREC, P_STOP_K, P_STOP_X0, P_AZ8,
    P_TONE_W, P_TONE_X, P_TONE_Y,
    /* drive */
    P_DR3, P_DRPH, P_DRSAT, P_DRDEAD,
    /* pick-off */
    P_PK3, P_PKPH, P_PKSAT, P_PKDNL, P_PKDNL_V, P_FEED_A2, P_FEED_U3, P_REFCOUP, P_RANGE_STEP, P_RANGE_HI, P_RANGE_LO, P_PKTONE_W,
    P_PKTONE_X, P_PKTONE_Y, P_DIGI, P_GAP_W,
    /* memories, all at the rate of the loops */
    P_HEAT_TAU, P_HEAT_PICKPH, P_HEAT_SPLIT, P_SELF_TAU, P_SELF_K, P_FATIGUE_TAU, P_FATIGUE_D, P_SUB_GAIN, P_SUB_LOSS, P_SUB_D,
    P_BIAS_AU,
    NPAR }; /* END PAR */

enum Slow { /* BEGIN SLOW */
    S_OMEGA, S_K0, S_KC, S_KS, S_D0, S_DC, S_DS, S_GPXX, S_GPXY, S_GPYX, S_GPYY, S_GDXX, S_GDXY, S_GDYX, S_GDYY, S_PHPX, S_PHPY,
    S_PHDX, S_PHDY, NSLOW }; /* END SLOW */

enum Cmd { /* BEGIN CMD */
    C_MODE, C_OSC, C_AMP, C_MOD, C_NU, C_VP, C_CR, C_GAIN, C_FREQ, C_VOLTX, C_VOLTY, C_BODY, NCMD }; /* END CMD */

enum Mode { M_FTR = 0, M_WHOLE = 1, M_OPEN = 2, M_BRAKE = 3 };

#define NS 10
#define NOUT 10 /* x_pick c s, y_pick c s, x_drive c s, y_drive c s, reference [rad/s], spare */
#define TWO_PI 6.283185307179586

typedef struct {
    double P[NPAR], prop[NS][NS + 2];
    double s[NS], phi, inc, w_int, tone_phi, pktone_phi;
    double zf[4], u[4], uq[8][4], agc_i, reb_i[2], quad_i;
    double heat[2], self_a2, fat_a2, sub_b;
    int range_high;
    long window;
    const double *slow;
    long n_slow;
    uint64_t rng[2];
    double spare;
    int have_spare;
} Plant;

static uint64_t rng_next(Plant *p) {
    uint64_t a = p->rng[0], b = p->rng[1];
    p->rng[0] = b;
    a ^= a << 23;
    p->rng[1] = a ^ b ^ (a >> 17) ^ (b >> 26);
    return p->rng[1] + b;
}

/* Polar Gaussian: slower than a table, but its tails are those of a Gaussian. */
static double gauss(Plant *p) {
    if (p->have_spare) {
        p->have_spare = 0;
        return p->spare;
    }
    double a, b, r;
    do {
        a = (double)(int64_t)rng_next(p) * 0x1p-63;
        b = (double)(int64_t)rng_next(p) * 0x1p-63;
        r = a * a + b * b;
    } while (r >= 1.0 || r == 0.0);
    r = sqrt(-2.0 * log(r) / r);
    p->spare = b * r;
    p->have_spare = 1;
    return a * r;
}

Plant *plant_new(const double *par, const double *prop, const double *slow, long n_slow, uint64_t seed) {
    Plant *p = calloc(1, sizeof(Plant));
    if (!p) return 0;
    memcpy(p->P, par, sizeof p->P);
    memcpy(p->prop, prop, sizeof p->prop);
    p->slow = slow;
    p->n_slow = n_slow;
    p->rng[0] = seed * 0x9E3779B97F4A7C15ULL + 1;
    p->rng[1] = seed ^ 0xD1B54A32D192ED03ULL;
    for (int i = 0; i < 32; i++) rng_next(p);
    p->w_int = par[P_W0];
    p->inc = par[P_W0] * par[P_H] * par[P_M];
    p->s[0] = 1e-6;
    return p;
}
void plant_free(Plant *p) { free(p); }
void plant_set_state(Plant *p, const double *s) { memcpy(p->s, s, sizeof p->s); }
void plant_get_state(const Plant *p, double *s) { memcpy(s, p->s, sizeof p->s); }
double plant_frequency(const Plant *p) { return p->w_int; }
int plant_sizes(int which) { return which == 0 ? NPAR : which == 1 ? NSLOW : which == 2 ? NCMD : NOUT; }

/* One sub-step of the linear part: only the entries that can differ from zero. */
static void propagate(Plant *p, const double u[2]) {
    double n[NS];
    double *s = p->s;
    for (int i = 0; i < 4; i++) {
        const double *r = p->prop[i];
        n[i] = r[0] * s[0] + r[1] * s[1] + r[2] * s[2] + r[3] * s[3] + r[4] * s[4] + r[5] * s[5] + r[10] * u[0] + r[11] * u[1];
    }
    for (int i = 4; i < 8; i++) n[i] = p->prop[i][i] * s[i] + p->prop[i][10 + (i & 1)] * u[i & 1];
    for (int i = 8; i < 10; i++) {
        const double *r = p->prop[i];
        double v = r[i] * s[i] + r[10] * u[0] + r[11] * u[1];
        for (int j = 0; j < 8; j++) v += r[j] * s[j];
        n[i] = v;
    }
    memcpy(s, n, sizeof n);
}

/* Forces that the exponential does not hold, as impulses of length h on w = velocity / w0. */
static void kick(Plant *p, const double *sl, const double h, const double body) {
    const double *P = p->P;
    double *s = p->s, x = s[0], y = s[1], vx = s[2], vy = s[3];
    double ax = -(sl[S_K0] + sl[S_KC]) * x - sl[S_KS] * y - (sl[S_D0] + sl[S_DC]) * vx - sl[S_DS] * vy + body;
    double ay = -sl[S_KS] * x - (sl[S_K0] - sl[S_KC]) * y - sl[S_DS] * vx - (sl[S_D0] - sl[S_DC]) * vy + body;
    if (P[P_DUF] != 0.0 || P[P_DUFX] != 0.0 || P[P_DUFY] != 0.0 || P[P_CUBX] != 0.0) {
        double r2 = P[P_DUF] * (x * x + y * y);
        ax -= r2 * x + P[P_DUFX] * x * x * x + P[P_CUBX] * y * y * y;
        ay -= r2 * y + P[P_DUFY] * y * y * y + P[P_CUBX] * x * x * x;
    }
    if (P[P_NLD] != 0.0 || P[P_NLDX] != 0.0 || P[P_NLDY] != 0.0) {
        double r2 = P[P_NLD] * (vx * vx + vy * vy);
        ax -= r2 * vx + P[P_NLDX] * vx * vx * vx;
        ay -= r2 * vy + P[P_NLDY] * vy * vy * vy;
    }
    if (P[P_QUADD] != 0.0 || P[P_COUL] != 0.0) {
        double r = sqrt(vx * vx + vy * vy) + 1e-9;
        double c = P[P_QUADD] * r + P[P_COUL] / (r + 1e-5);
        ax -= c * vx;
        ay -= c * vy;
    }
    if (P[P_COULX] != 0.0 || P[P_COULY] != 0.0) {
        ax -= P[P_COULX] * tanh(vx * 2e3);
        ay -= P[P_COULY] * tanh(vy * 2e3);
    }
    if (P[P_NONREC] != 0.0) { /* a gyroscopic force whose strength goes with the energy */
        double c = P[P_NONREC] * (x * x + y * y + vx * vx + vy * vy);
        ax += c * vy;
        ay -= c * vx;
    }
    if (P[P_STOP_K] != 0.0) { /* one-sided contact of the moving mass on each axis */
        if (x > P[P_STOP_X0]) ax -= P[P_STOP_K] * (x - P[P_STOP_X0]);
        if (y > P[P_STOP_X0]) ay -= P[P_STOP_K] * (y - P[P_STOP_X0]);
    }
    if (P[P_AZ8] != 0.0) { /* loss that follows the azimuth of the wave with eight lobes, whatever the amplitude */
        double a = x * x + vx * vx, b = y * y + vy * vy, m = 2.0 * (x * y + vx * vy), e = a + b + 1e-12;
        double c2 = (a - b) / e, s2 = m / e, c4 = c2 * c2 - s2 * s2;
        ax -= P[P_AZ8] * c4 * vx;
        ay -= P[P_AZ8] * c4 * vy;
    }
    if (P[P_TONE_W] != 0.0) {
        double c = cos(p->tone_phi);
        p->tone_phi += P[P_TONE_W] * h;
        ax += P[P_TONE_X] * c;
        ay += P[P_TONE_Y] * c;
    }
    vx += h * ax;
    vy += h * ay;
    double g = 2.0 * P[P_KAPPA] * sl[S_OMEGA] * h, n = 1.0 - 0.5 * g * g; /* a turn, so that it does no work */
    s[2] = n * vx + g * vy;
    s[3] = n * vy - g * vx;
}

static double clip(double v, double m) { return v > m ? m : v < -m ? -m : v; }

/* From the converter's code to what reaches the electrodes. */
static void drive_chain(const Plant *p, const double *sl, double u[2]) {
    const double *P = p->P;
    double a = u[0], b = u[1];
    if (P[P_DR3] != 0.0) a += P[P_DR3] * a * a * a, b += P[P_DR3] * b * b * b;
    if (P[P_DRSAT] != 0.0) a = clip(a, P[P_DRSAT]), b = clip(b, P[P_DRSAT]);
    if (P[P_DRDEAD] != 0.0) {
        double d = P[P_DRDEAD];
        a = a > d ? a - d : a < -d ? a + d : 0.0;
        b = b > d ? b - d : b < -d ? b + d : 0.0;
    }
    u[0] = a + sl[S_GDXX] * a + sl[S_GDXY] * b;
    u[1] = b + sl[S_GDYX] * a + sl[S_GDYY] * b;
}

/* From the amplifiers' poles to the converter's codes. */
static void pickoff_chain(Plant *p, const double *sl, double v[2]) {
    const double *P = p->P, *s = p->s;
    double x = s[8], y = s[9];
    /* the derivative of the band-limited signal in units of w0: a delay is a step along it */
    double qx = -s[2], qy = -s[3];
    double a = x + sl[S_GPXX] * x + sl[S_GPXY] * y + sl[S_PHPX] * qx, b = y + sl[S_GPYX] * x + sl[S_GPYY] * y + sl[S_PHPY] * qy;
    if (P[P_PKPH] != 0.0) a += P[P_PKPH] * a * a * qx, b += P[P_PKPH] * b * b * qy;
    if (P[P_FEED_A2] != 0.0) {
        a += P[P_FEED_A2] * (s[0] * s[0] + s[2] * s[2]) * s[4];
        b += P[P_FEED_A2] * (s[1] * s[1] + s[3] * s[3]) * s[5];
    }
    if (P[P_FEED_U3] != 0.0) a += P[P_FEED_U3] * s[4] * s[4] * s[4], b += P[P_FEED_U3] * s[5] * s[5] * s[5];
    if (P[P_PK3] != 0.0) a += P[P_PK3] * a * a * a, b += P[P_PK3] * b * b * b;
    if (P[P_PKSAT] != 0.0) a = clip(a, P[P_PKSAT]), b = clip(b, P[P_PKSAT]);
    if (P[P_PKTONE_W] != 0.0) {
        double c = cos(p->pktone_phi);
        p->pktone_phi += P[P_PKTONE_W] * P[P_H] * P[P_M];
        a += P[P_PKTONE_X] * c;
        b += P[P_PKTONE_Y] * c;
    }
    if (P[P_SIGMA_V] != 0.0) {
        a += P[P_SIGMA_V] * gauss(p);
        b += P[P_SIGMA_V] * gauss(p);
    }
    if (P[P_PKDNL] != 0.0) {
        if (a > P[P_PKDNL_V]) a += P[P_PKDNL];
        if (b > P[P_PKDNL_V]) b += P[P_PKDNL];
    }
    if (P[P_ADC_LSB] != 0.0) {
        a = P[P_ADC_LSB] * rint(a / P[P_ADC_LSB]);
        b = P[P_ADC_LSB] * rint(b / P[P_ADC_LSB]);
    }
    v[0] = clip(a, P[P_ADC_FS]);
    v[1] = clip(b, P[P_ADC_FS]);
}

static void limit(double u[2], double m) {
    double r = hypot(u[0], u[1]);
    if (r > m) u[0] *= m / r, u[1] *= m / r;
}

static void pll(Plant *p, double e, double T, double *w) {
    double kp = TWO_PI * p->P[P_PLL_HZ], ki = 0.25 * kp * kp;
    p->w_int += ki * e * T;
    *w = p->w_int + kp * e;
}

/* The amplitude loop: proportional and integral, the integral held while the converter is at its limit. */
static double agc(Plant *p, double target, double a, double T) {
    double kp = TWO_PI * p->P[P_AGC_HZ], ki = 0.25 * kp * kp, g = p->P[P_GNOM], e = target - a;
    double w = (kp * e + p->agc_i) / g;
    if (fabs(w) < p->P[P_UMAX]) p->agc_i += ki * e * T;
    else p->agc_i = 0.0;
    return clip(w, p->P[P_UMAX]);
}

static void loops(Plant *p, const double *c, double t, double T) {
    const double *P = p->P;
    int mode = (int)c[C_MODE];
    double *z = p->zf, g = P[P_GNOM], umax = P[P_UMAX], w = p->w_int;
    double nu[4] = {0, 0, 0, 0}, target = c[C_AMP] * (1.0 + c[C_MOD] * sin(TWO_PI * c[C_NU] * t));
    if (mode == M_OPEN) {
        nu[0] = c[C_VOLTX];
        nu[2] = c[C_VOLTY];
        w = TWO_PI * c[C_FREQ];
        p->agc_i = p->reb_i[0] = p->reb_i[1] = p->quad_i = 0.0;
    } else if (mode == M_BRAKE) {
        double k = TWO_PI * 4.0 / g;
        for (int i = 0; i < 2; i++) {
            nu[2 * i] = k * z[2 * i + 1];
            nu[2 * i + 1] = -k * z[2 * i];
            limit(nu + 2 * i, 0.5 * umax);
        }
        p->agc_i = p->reb_i[0] = p->reb_i[1] = p->quad_i = 0.0;
    } else if (mode == M_FTR) {
        int o = 2 * (int)c[C_OSC], q = 2 - o;
        double a = hypot(z[o], z[o + 1]), kp = TWO_PI * P[P_REB_HZ], ki = 0.25 * kp * kp;
        double lock = P[P_ALOCK] < 0.3 * c[C_AMP] ? P[P_ALOCK] : 0.3 * c[C_AMP];
        if (a < lock) { /* grow along whatever phase is there */
            nu[o] = -umax * z[o + 1] / (a + 1e-12);
            nu[o + 1] = umax * z[o] / (a + 1e-12);
            p->agc_i = 0.0;
        } else {
            pll(p, atan2(z[o + 1], z[o]), T, &w);
            nu[o + 1] = c[C_GAIN] != 0.0 ? c[C_GAIN] * a : agc(p, target, a, T);
            if (c[C_GAIN] != 0.0) p->agc_i = 0.0;
        }
        double f[2] = {-(kp * z[q] + p->reb_i[0]) / g, -(kp * z[q + 1] + p->reb_i[1]) / g};
        if (hypot(f[0], f[1]) < umax) {
            p->reb_i[0] += ki * z[q] * T;
            p->reb_i[1] += ki * z[q + 1] * T;
        } else {
            p->reb_i[0] = p->reb_i[1] = 0.0;
        }
        limit(f, umax);
        nu[q] = -f[1]; /* i times the wanted change of the envelope */
        nu[q + 1] = f[0];
        p->quad_i = 0.0;
    } else {
        double sr = z[0] * z[0] - z[1] * z[1] + z[2] * z[2] - z[3] * z[3], si = 2.0 * (z[0] * z[1] + z[2] * z[3]);
        double d = 0.5 * atan2(si, sr), cd = cos(d), sd = sin(d), lock = P[P_ALOCK];
        double xr = z[0] * cd + z[1] * sd, xi = z[1] * cd - z[0] * sd, yr = z[2] * cd + z[3] * sd, yi = z[3] * cd - z[2] * sd;
        double a = hypot(xr, yr), n0 = xr / (a + 1e-15), n1 = yr / (a + 1e-15), q = -(-xi * n1 + yi * n0);
        if (a < lock) {
            double r = sqrt(z[0] * z[0] + z[1] * z[1] + z[2] * z[2] + z[3] * z[3]) + 1e-12;
            for (int i = 0; i < 2; i++) {
                nu[2 * i] = -umax * z[2 * i + 1] / r;
                nu[2 * i + 1] = umax * z[2 * i] / r;
            }
            p->agc_i = p->quad_i = 0.0;
        } else {
            pll(p, d, T, &w);
            double kp = TWO_PI * P[P_QUAD_HZ], ki = 0.25 * kp * kp, par = agc(p, target, a, T), pc = -(kp * q + p->quad_i) / g;
            if (fabs(pc) < umax) p->quad_i += ki * q * T;
            else p->quad_i = 0.0;
            pc = clip(pc, umax);
            nu[0] = -pc * n1;
            nu[2] = pc * n0;
            nu[1] = par * n0 - c[C_VP] * n1;
            nu[3] = par * n1 + c[C_VP] * n0;
        }
        p->reb_i[0] = p->reb_i[1] = 0.0;
    }
    if (c[C_CR] != 0.0)
        for (int i = 0; i < 4; i++) nu[i] += c[C_CR] * z[i];
    int dly = (int)P[P_DELAY_W];
    for (int k = 0; k < dly; k++) memcpy(p->uq[k], p->uq[k + 1], sizeof p->u);
    memcpy(p->uq[dly], nu, sizeof p->u);
    memcpy(p->u, p->uq[0], sizeof p->u);
    limit(p->u, P[P_DAC_FS]);
    limit(p->u + 2, P[P_DAC_FS]);
    p->inc = w * P[P_H] * P[P_M];
}

/* Memories of powers and amplitudes; what they do is added to this window's slow variables. */
static void memories(Plant *p, double T, double *sl) {
    const double *P = p->P, *u = p->u, *z = p->zf;
    double ux = 0.5 * (u[0] * u[0] + u[1] * u[1]), uy = 0.5 * (u[2] * u[2] + u[3] * u[3]);
    double a2 = z[0] * z[0] + z[1] * z[1] + z[2] * z[2] + z[3] * z[3];
    if (P[P_HEAT_TAU] > 0.0) {
        p->heat[0] += T / P[P_HEAT_TAU] * (ux - p->heat[0]);
        p->heat[1] += T / P[P_HEAT_TAU] * (uy - p->heat[1]);
        sl[S_PHPX] += P[P_HEAT_PICKPH] * p->heat[0];
        sl[S_PHPY] += P[P_HEAT_PICKPH] * p->heat[1];
        sl[S_KS] += P[P_HEAT_SPLIT] * (p->heat[0] + p->heat[1]);
    }
    if (P[P_SELF_TAU] > 0.0) {
        p->self_a2 += T / P[P_SELF_TAU] * (a2 - p->self_a2);
        sl[S_K0] += P[P_SELF_K] * p->self_a2;
    }
    if (P[P_FATIGUE_TAU] > 0.0) {
        p->fat_a2 += T / P[P_FATIGUE_TAU] * (a2 - p->fat_a2);
        sl[S_D0] += P[P_FATIGUE_D] * p->fat_a2;
    }
    if (P[P_SUB_D] != 0.0) { /* a half-frequency mode that the wave pumps above a threshold; b is its energy */
        double gr = P[P_SUB_GAIN] * a2 - P[P_SUB_LOSS] - P[P_SUB_GAIN] * p->sub_b;
        p->sub_b += T * (gr * p->sub_b + 1e-4);
        if (p->sub_b < 0.0) p->sub_b = 0.0;
        sl[S_D0] += P[P_SUB_D] * p->sub_b;
    }
    if (P[P_REFCOUP] != 0.0) { /* the reference of both converters gives way to the total drive current */
        double g = P[P_REFCOUP] * sqrt(2.0 * (ux + uy));
        sl[S_GPXX] += g;
        sl[S_GPYY] += g;
    }
    if (P[P_DRPH] != 0.0) {
        sl[S_PHDX] += P[P_DRPH] * 2.0 * ux;
        sl[S_PHDY] += P[P_DRPH] * 2.0 * uy;
    }
    if (P[P_RANGE_STEP] != 0.0) { /* a programmable gain with its two thresholds */
        double a = sqrt(a2);
        if (a > P[P_RANGE_HI]) p->range_high = 1;
        if (a < P[P_RANGE_LO]) p->range_high = 0;
        if (p->range_high) sl[S_GPXX] += P[P_RANGE_STEP], sl[S_GPYY] += P[P_RANGE_STEP];
    }
    if (P[P_BIAS_AU] != 0.0) sl[S_OMEGA] += P[P_BIAS_AU] * (ux - uy);
    if (P[P_GAP_W] != 0.0) sl[S_GPXX] += P[P_GAP_W] * sl[S_OMEGA] * sl[S_OMEGA], sl[S_GPYY] += P[P_GAP_W] * sl[S_OMEGA] * sl[S_OMEGA];
}

/* Run n windows of a command; out is n x NOUT or null. */
void plant_run(Plant *p, const double *c, long n, double *out) {
    const double *P = p->P;
    const int R = (int)P[P_R], M = (int)P[P_M];
    const double h = P[P_H], tick = h * M, T = tick * R, alpha = 1.0 - exp(-TWO_PI * P[P_ENV_HZ] * T);
    double sl[NSLOW];
    for (long k = 0; k < n; k++, p->window++) {
        double t = (p->window * (double)R + 0.5 * (R - 1)) * tick, at = t / P[P_SLOW_DT];
        long j = (long)at;
        if (j > p->n_slow - 2) j = p->n_slow - 2;
        at -= j;
        for (int i = 0; i < NSLOW; i++) sl[i] = (1.0 - at) * p->slow[j * NSLOW + i] + at * p->slow[(j + 1) * NSLOW + i];
        memories(p, T, sl);
        double acc[4] = {0, 0, 0, 0}, cc = 0.0, cs = 0.0, ss = 0.0;
        double cm = cos(P[P_ADVANCE] + sl[S_PHDX]), sm = sin(P[P_ADVANCE] + sl[S_PHDX]);
        double cy = cos(P[P_ADVANCE] + sl[S_PHDY]), sy = sin(P[P_ADVANCE] + sl[S_PHDY]), frequency = 0.0;
        double sigma_w = P[P_SIGMA_W] * sqrt(2.0 * tick), u[2];
        double digi = P[P_DIGI] != 0.0 && c[C_MOD] != 0.0 ? P[P_DIGI] * sin(TWO_PI * c[C_NU] * t) : 0.0;
        for (int i = 0; i < R; i++) {
            double cp = cos(p->phi), sp = sin(p->phi), v[2];
            u[0] = p->u[0] * (cp * cm - sp * sm) - p->u[1] * (sp * cm + cp * sm);
            u[1] = p->u[2] * (cp * cy - sp * sy) - p->u[3] * (sp * cy + cp * sy);
            if (P[P_DAC_LSB] != 0.0) {
                u[0] = P[P_DAC_LSB] * rint(u[0] / P[P_DAC_LSB]);
                u[1] = P[P_DAC_LSB] * rint(u[1] / P[P_DAC_LSB]);
            }
            drive_chain(p, sl, u);
            pickoff_chain(p, sl, v);
            v[1] += digi * cp;
            acc[0] += v[0] * cp;
            acc[1] -= v[0] * sp;
            acc[2] += v[1] * cp;
            acc[3] -= v[1] * sp;
            cc += cp * cp;
            cs -= cp * sp;
            ss += sp * sp;
            if (sigma_w != 0.0) {
                p->s[2] += sigma_w * gauss(p);
                p->s[3] += sigma_w * gauss(p);
            }
            double step = p->inc, body = 0.0;
            for (int m = 0; m < M; m++) {
                if (c[C_BODY] != 0.0) body = P[P_BODY_GAIN] * c[C_BODY] * cos(p->phi + step * (m + 0.5) / M + P[P_BODY_PHASE]);
                kick(p, sl, h, body);
                propagate(p, u);
            }
            frequency += step;
            p->phi += step;
            if (p->phi > 3.141592653589793) p->phi -= TWO_PI;
        }
        /* least squares of c cos - s sin over the window: no image at twice the carrier, whatever its length */
        double det = cc * ss - cs * cs;
        for (int i = 0; i < 4; i += 2) {
            double a = acc[i], b = acc[i + 1];
            acc[i] = (ss * a - cs * b) / det;
            acc[i + 1] = (cc * b - cs * a) / det;
        }
        for (int i = 0; i < 4; i++) p->zf[i] += alpha * (acc[i] - p->zf[i]);
        if (out) {
            double *o = out + k * NOUT;
            memcpy(o, acc, sizeof acc);
            memcpy(o + 4, p->u, sizeof p->u);
            o[8] = frequency / (R * tick);
            o[9] = t;
        }
        loops(p, c, t, T);
    }
}
