// An antagonistic joint without effects in plain C: Krogstad's steps as in via_sim.joint.kernel, two odd polynomial
// springs, and nothing else. What a hand-written simulator of one particular joint would cost: alone, and many at once.
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

enum { L = 16 };

static inline void torques_of_lanes(const double* c, const double* u, const double* angle, double* out) {
    for (int l = 0; l < L; ++l) {
        const double first = spring(c, angle[l] - angle[L + l]), second = spring(c, angle[l] - angle[2 * L + l]);
        out[l] = -first - second;
        out[L + l] = u[l] + first;
        out[2 * L + l] = u[L + l] + second;
    }
}

// `joint` for `count` joints, a multiple of L: w (3, 20, count), gain (2, count) of motor torques -> angles (ticks, 3,
// count). Rows of a block: angles, velocities, stage, torques n, a, b, d.
void lanes(const double* motor, long ticks, long substeps, const double* w, const double* c, const double* gain,
           long count, double* angles) {
    for (long first = 0; first < count; first += L) {
        double x[3 * L] = {0}, v[3 * L] = {0}, at[3 * L], n[3 * L], a[3 * L], b[3 * L], d[3 * L], u[2 * L], s[3][20][L];
        for (int i = 0; i < 60; ++i)
            for (int l = 0; l < L; ++l) s[i / 20][i % 20][l] = w[i * count + first + l];
        for (long k = 0; k < ticks; ++k) {
            for (int i = 0; i < 2; ++i)
                for (int l = 0; l < L; ++l) u[i * L + l] = gain[i * count + first + l] * motor[2 * k + i];
            for (long j = 0; j < substeps; ++j) {
                torques_of_lanes(c, u, x, n);
                for (int i = 0; i < 3; ++i)
                    for (int l = 0, m = i * L; l < L; ++l, ++m)
                        at[m] = x[m] + s[i][HALF + 1][l] * v[m] + s[i][A_N + 1][l] * n[m];
                torques_of_lanes(c, u, at, a);
                for (int i = 0; i < 3; ++i)
                    for (int l = 0, m = i * L; l < L; ++l, ++m)
                        at[m] = x[m] + s[i][HALF + 1][l] * v[m] + s[i][B_N + 1][l] * n[m] + s[i][B_A + 1][l] * a[m];
                torques_of_lanes(c, u, at, b);
                for (int i = 0; i < 3; ++i)
                    for (int l = 0, m = i * L; l < L; ++l, ++m)
                        at[m] = x[m] + s[i][FULL + 1][l] * v[m] + s[i][C_N + 1][l] * n[m] + s[i][C_B + 1][l] * b[m];
                torques_of_lanes(c, u, at, d);
                for (int i = 0; i < 3; ++i)
                    for (int l = 0, m = i * L; l < L; ++l, ++m) {
                        const double both = a[m] + b[m];
                        x[m] += s[i][FULL + 1][l] * v[m] + s[i][END_N + 1][l] * n[m] + s[i][END_AB + 1][l] * both +
                                s[i][END_C + 1][l] * d[m];
                        v[m] = s[i][FULL][l] * v[m] + s[i][END_N][l] * n[m] + s[i][END_AB][l] * both +
                               s[i][END_C][l] * d[m];
                    }
            }
            for (int i = 0; i < 3; ++i)
                for (int l = 0; l < L; ++l) angles[(3 * k + i) * count + first + l] = x[i * L + l];
        }
    }
}
