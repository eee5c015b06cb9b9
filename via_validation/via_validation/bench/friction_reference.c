// The joint of joint_reference.c with five effects in plain C: dry friction and torque ripple of motor 1, Stribeck
// friction and quadratic drag of the link, commands late by whole ticks. Same steps and events as via_sim.joint.kernel.
#include <math.h>

enum { HALF = 0, FULL = 2, A_N = 4, B_N = 6, B_A = 8, C_N = 10, C_B = 12, END_N = 14, END_AB = 16, END_C = 18 };
enum { LINK = 0, MOTOR = 1, MOST_EVENTS = 64 };

// c (14,): spring coefficients (2); amplitude, order, phase of the ripple; drag; breakaway and kinetic friction and
// velocity of the link; dry friction of the motor; inertia of link and motors; their viscous friction follows (2).
enum { AMPLITUDE = 2, ORDER, PHASE, DRAG, BREAKAWAY, KINETIC, VELOCITY, DRY, M, B, D_LINK, D_MOTOR };

static inline double spring(const double* c, double phi) { return (c[0] + c[1] * phi * phi) * phi; }

// Torques without friction of the state (angle, velocity) (6,).
static inline void motive(const double* c, const double* u, const double* y, double* out) {
    const double first = spring(c, y[0] - y[1]), second = spring(c, y[0] - y[2]);
    out[0] = -first - second - c[DRAG] * y[3] * fabs(y[3]);
    out[1] = u[0] + first + c[AMPLITUDE] * sin(c[ORDER] * y[1] + c[PHASE]);
    out[2] = u[1] + second;
}

static inline double stribeck(const double* c, double speed) {
    const double ratio = speed / c[VELOCITY];
    return c[KINETIC] + (c[BREAKAWAY] - c[KINETIC]) * exp(-ratio * ratio);
}

// Torques with friction in the modes of link and motor 1: 0 at rest, else the direction of slip.
static inline void torques(const double* c, const double* u, const int* mode, const double* y, double* out) {
    motive(c, u, y, out);
    out[LINK] = mode[0] ? out[LINK] - mode[0] * stribeck(c, mode[0] * y[3]) : 0.0;
    out[MOTOR] = mode[1] ? out[MOTOR] - mode[1] * c[DRY] : 0.0;
}

static int mode_of(double speed, double torque, double breakaway) {
    if (speed != 0.0) return speed > 0.0 ? 1 : -1;
    return torque > breakaway ? 1 : torque < -breakaway ? -1 : 0;
}

static inline double larger(double a, double b) { return a > b ? a : b; }

// > 0 outside of the modes.
static double violation(const double* c, const double* u, const int* mode, const double* y) {
    double t[3], worst = -INFINITY;
    motive(c, u, y, t);
    worst = larger(worst, mode[0] ? -mode[0] * y[3] : fabs(t[LINK]) - c[BREAKAWAY]);
    return larger(worst, mode[1] ? -mode[1] * y[4] : fabs(t[MOTOR]) - c[DRY]);
}

static void phi_functions(double z, double* p) {
    if (z < -2.0) {
        p[0] = exp(z), p[1] = expm1(z) / z, p[2] = (p[1] - 1.0) / z;
        p[3] = (p[2] - 0.5) / z, p[4] = (p[3] - 1.0 / 6.0) / z;
        return;
    }
    double sum = 0.0, last = 1.0 / 24.0;
    for (int n = 4; n < 28; ++n, last *= z / n) sum += last;
    p[4] = sum, p[3] = z * p[4] + 1.0 / 6.0, p[2] = z * p[3] + 0.5, p[1] = z * p[2] + 1.0, p[0] = z * p[1] + 1.0;
}

// Krogstad's weights for a step of h [s] into w (3, 20).
static void weigh(const double* c, double h, double* w) {
    for (int i = 0; i < 3; ++i, w += 20) {
        double inertia = c[i ? B : M], z = -h * c[i ? D_MOTOR : D_LINK] / inertia, k = h / inertia, p[5], q[5];
        phi_functions(z, p), phi_functions(0.5 * z, q);
        w[HALF] = q[0], w[HALF + 1] = 0.5 * h * q[1];
        w[FULL] = p[0], w[FULL + 1] = h * p[1];
        w[A_N] = 0.5 * k * q[1], w[A_N + 1] = 0.25 * h * k * q[2];
        w[B_N] = k * (0.5 * q[1] - q[2]), w[B_N + 1] = 0.5 * h * k * (0.5 * q[2] - q[3]);
        w[B_A] = k * q[2], w[B_A + 1] = 0.5 * h * k * q[3];
        w[C_N] = k * (p[1] - 2.0 * p[2]), w[C_N + 1] = h * k * (p[2] - 2.0 * p[3]);
        w[C_B] = 2.0 * k * p[2], w[C_B + 1] = 2.0 * h * k * p[3];
        w[END_N] = k * (p[1] - 3.0 * p[2] + 4.0 * p[3]), w[END_N + 1] = h * k * (p[2] - 3.0 * p[3] + 4.0 * p[4]);
        w[END_AB] = k * (2.0 * p[2] - 4.0 * p[3]), w[END_AB + 1] = h * k * (2.0 * p[3] - 4.0 * p[4]);
        w[END_C] = k * (4.0 * p[3] - p[2]), w[END_C + 1] = h * k * (4.0 * p[4] - p[3]);
    }
}

// A step from x (6,) into y (9,): motion at the end, then velocities at the midpoint.
static inline void step(const double* c, const double* u, const int* mode, const double* w, const double* x,
                        double* y) {
    double n[3], a[3], b[3], d[3], at[6];
    torques(c, u, mode, x, n);
    for (int i = 0; i < 3; ++i) {
        const double *s = w + 20 * i, v = x[3 + i];
        at[i] = x[i] + s[HALF + 1] * v + s[A_N + 1] * n[i];
        at[3 + i] = y[6 + i] = s[HALF] * v + s[A_N] * n[i];
    }
    torques(c, u, mode, at, a);
    for (int i = 0; i < 3; ++i) {
        const double *s = w + 20 * i, v = x[3 + i];
        at[i] = x[i] + s[HALF + 1] * v + s[B_N + 1] * n[i] + s[B_A + 1] * a[i];
        at[3 + i] = s[HALF] * v + s[B_N] * n[i] + s[B_A] * a[i];
        y[6 + i] = 0.5 * (y[6 + i] + at[3 + i]);
    }
    torques(c, u, mode, at, b);
    for (int i = 0; i < 3; ++i) {
        const double *s = w + 20 * i, v = x[3 + i];
        at[i] = x[i] + s[FULL + 1] * v + s[C_N + 1] * n[i] + s[C_B + 1] * b[i];
        at[3 + i] = s[FULL] * v + s[C_N] * n[i] + s[C_B] * b[i];
    }
    torques(c, u, mode, at, d);
    for (int i = 0; i < 3; ++i) {
        const double *s = w + 20 * i, v = x[3 + i], both = a[i] + b[i];
        y[i] = x[i] + s[FULL + 1] * v + s[END_N + 1] * n[i] + s[END_AB + 1] * both + s[END_C + 1] * d[i];
        y[3 + i] = s[FULL] * v + s[END_N] * n[i] + s[END_AB] * both + s[END_C] * d[i];
    }
}

static void partial(const double* c, const double* u, const int* mode, double h, const double* x, double* y) {
    double w[60];
    weigh(c, h, w);
    step(c, u, mode, w, x, y);
}

// Advance x (6,) by h [s], with a restart at each event; w (3, 20) weights of a whole step.
static void advance(const double* c, const double* u, double h, const double* w, double* x) {
    double left = h, y[9], t[3];
    for (int event = 0; event < MOST_EVENTS && left > 0.0; ++event) {
        motive(c, u, x, t);
        const int mode[2] = {mode_of(x[3], t[LINK], c[BREAKAWAY]), mode_of(x[4], t[MOTOR], c[DRY])};
        double high = left;
        if (event) partial(c, u, mode, left, x, y);
        else step(c, u, mode, w, x, y);
        double outside = violation(c, u, mode, y);
        if (outside <= 0.0 && (mode[0] * y[6] < 0.0 || mode[1] * y[7] < 0.0)) {
            partial(c, u, mode, 0.5 * left, x, y);
            outside = violation(c, u, mode, y);
            if (outside > 0.0) high = 0.5 * left;
            else partial(c, u, mode, left, x, y);
        }
        if (outside > 0.0) {  // Illinois method
            double low = 0.0, at_low = violation(c, u, mode, x), at_high = outside;
            const double nearest = 0.5e-12 * h;
            for (int trial = 0, last = 0; trial < 100 && high - low > 1e-12 * h; ++trial) {
                double middle = 0.5 * (low + high);
                if (at_low < 0.0 && trial % 8 != 7) {
                    middle = low + (high - low) * at_low / (at_low - at_high);
                    middle = fmin(fmax(middle, low + nearest), high - nearest);
                }
                partial(c, u, mode, middle, x, y);
                outside = violation(c, u, mode, y);
                if (outside > 0.0) {
                    high = middle, at_high = outside, at_low *= last > 0 ? 0.5 : 1.0, last = 1;
                } else {
                    low = middle, at_low = outside, at_high *= last < 0 ? 0.5 : 1.0, last = -1;
                }
            }
            partial(c, u, mode, high, x, y);
        }
        left -= high;
        if (mode[0] * y[3] < 0.0) y[3] = 0.0;
        if (mode[1] * y[4] < 0.0) y[4] = 0.0;
        for (int i = 0; i < 6; ++i) x[i] = y[i];
    }
}

// motor (ticks, 2) [N m], late [ticks], h [s], c (14,) -> angles (ticks, 3) from rest at zero.
void rubbing(const double* motor, long ticks, long substeps, long late, double h, const double* c, double* angles) {
    double x[6] = {0}, w[60];
    const double still[2] = {0};
    weigh(c, h / substeps, w);
    for (long k = 0; k < ticks; ++k) {
        for (long j = 0; j < substeps; ++j) advance(c, k < late ? still : motor + 2 * (k - late), h / substeps, w, x);
        for (int i = 0; i < 3; ++i) angles[3 * k + i] = x[i];
    }
}
