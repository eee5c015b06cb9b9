// An antagonistic joint without effects in plain C: Krogstad's steps as in via_sim.joint.kernel, two odd polynomial
// springs, and nothing else. What a hand-written simulator of one particular joint would cost.
enum { HALF = 0, FULL = 2, A_N = 4, B_N = 6, B_A = 8, C_N = 10, C_B = 12, END_N = 14, END_AB = 16, END_C = 18 };

static inline double spring(const double* c, double phi) {
    const double square = phi * phi;
    return (c[0] + c[1] * square) * phi;
}

static inline void torques(const double* c, const double* u, const double* angle, double* out) {
    const double first = spring(c, angle[0] - angle[1]), second = spring(c, angle[0] - angle[2]);
    out[0] = -first - second;
    out[1] = u[0] + first;
    out[2] = u[1] + second;
}

// motor (ticks, 2) [N m], w (3, 20) weights as of kernel.W, c (2,) coefficients -> angles (ticks, 3) from rest at zero.
void joint(const double* motor, long ticks, long substeps, const double* w, const double* c, double* angles) {
    double x[3] = {0}, v[3] = {0}, at[3], n[3], a[3], b[3], d[3];
    for (long k = 0; k < ticks; ++k) {
        for (long j = 0; j < substeps; ++j) {
            torques(c, motor + 2 * k, x, n);
            for (int i = 0; i < 3; ++i) {
                const double* s = w + 20 * i + 1;
                at[i] = x[i] + s[HALF] * v[i] + s[A_N] * n[i];
            }
            torques(c, motor + 2 * k, at, a);
            for (int i = 0; i < 3; ++i) {
                const double* s = w + 20 * i + 1;
                at[i] = x[i] + s[HALF] * v[i] + s[B_N] * n[i] + s[B_A] * a[i];
            }
            torques(c, motor + 2 * k, at, b);
            for (int i = 0; i < 3; ++i) {
                const double* s = w + 20 * i + 1;
                at[i] = x[i] + s[FULL] * v[i] + s[C_N] * n[i] + s[C_B] * b[i];
            }
            torques(c, motor + 2 * k, at, d);
            for (int i = 0; i < 3; ++i) {
                const double *s = w + 20 * i, both = a[i] + b[i];
                x[i] += s[FULL + 1] * v[i] + s[END_N + 1] * n[i] + s[END_AB + 1] * both + s[END_C + 1] * d[i];
                v[i] = s[FULL] * v[i] + s[END_N] * n[i] + s[END_AB] * both + s[END_C] * d[i];
            }
        }
        for (int i = 0; i < 3; ++i) angles[3 * k + i] = x[i];
    }
}
