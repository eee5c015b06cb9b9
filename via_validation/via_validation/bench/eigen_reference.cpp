// The recursions of via_estimators.rls, via_estimators.qr and via_estimators.extended_kalman with Eigen's matrices of
// fixed size: the same arithmetic, folded over a whole log. What a hand-written C++ estimator would cost.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace {
constexpr int N = 9;
using Vector = Eigen::Matrix<double, N, 1>;
using Square = Eigen::Matrix<double, N, N, Eigen::RowMajor>;
using Rows = Eigen::Map<const Vector>;
}  // namespace

// rows (count, N), y (count,) -> w (N,); P starts as prior times the unit matrix.
extern "C" void rls(const double* rows, const double* y, long count, double prior, double* result) {
    Square P = prior * Square::Identity();
    Vector w = Vector::Zero();
    for (long k = 0; k < count; ++k) {
        const Vector v = Rows(rows + k * N);
        const Vector g = P * v;
        const double e = y[k] - v.dot(w);
        const Vector part = g / (1.0 + v.dot(g));
        P.noalias() -= part * g.transpose();
        w += part * e;
    }
    Eigen::Map<Vector>(result, N) = w;
}

// rows (count, N), y (count,) -> x (N,) after every row, the last one kept; R starts as prior times the unit matrix,
// keep is the forgetting factor.
extern "C" void qr_rls(const double* rows, const double* y, long count, double prior, double keep, double* result) {
    Square R = prior * Square::Identity();
    Vector p = Vector::Zero(), x = Vector::Zero();
    const double root = std::sqrt(keep);
    for (long k = 0; k < count; ++k) {
        Vector row = Rows(rows + k * N);
        double left = y[k];
        R *= root;
        p *= root;
        for (int j = 0; j < N; ++j) {
            if (row[j] == 0.0) continue;
            const double length = std::sqrt(R(j, j) * R(j, j) + row[j] * row[j]);
            const double c = R(j, j) / length, s = row[j] / length;
            for (int i = j; i < N; ++i) {
                const double above = R(j, i);
                R(j, i) = c * above + s * row[i];
                row[i] = c * row[i] - s * above;
            }
            const double above = p[j];
            p[j] = c * above + s * left;
            left = c * left - s * above;
        }
        x = R.triangularView<Eigen::Upper>().solve(p);
        // Otherwise a clever compiler would solve only once, after the last row.
        asm volatile("" : : "g"(x.data()) : "memory");
    }
    Eigen::Map<Vector>(result, N) = x;
}

namespace {
constexpr int M = 8, TERMS = 3, FIRST = 5;  // states: angle, velocity, B_0/B, D, F, then three odd powers
using State = Eigen::Matrix<double, M, 1>;
using Covariance = Eigen::Matrix<double, M, M, Eigen::RowMajor>;
using Slopes = Eigen::Matrix<double, 2, M, Eigen::RowMajor>;
using Terms = Eigen::Matrix<double, TERMS, 1>;

struct Model {
    double scale, inertia, slow;  // deflection scale, B_0, v_s
};

struct Factors {
    double keep, first, second, keep_slope, first_slope, second_slope;
    Factors(double rate, double h) {
        const double z = rate * h;
        double e, p1, p2, p3;
        if (z < 0.5) {
            double term = 1.0 / 6.0;
            p3 = 0.0;
            for (int k = 0; k < 10; ++k) {
                p3 += term;
                term *= -z / (k + 4);
            }
            p2 = 0.5 - z * p3, p1 = 1.0 - z * p2, e = 1.0 - z * p1;
        } else {
            e = std::exp(-z), p1 = (1.0 - e) / z, p2 = (1.0 - p1) / z, p3 = (0.5 - p2) / z;
        }
        keep = e, first = h * p1, second = h * h * p2;
        keep_slope = -h * e, first_slope = h * h * (p2 - p1), second_slope = h * h * h * (2.0 * p3 - p2);
    }
};

void spring(const Model& model, double phi, Terms& f, Terms& g) {
    const double z = phi / model.scale;
    double odd = 1.0;
    for (int j = 0; j < TERMS; ++j) {
        g[j] = odd;
        f[j] = model.scale * z * odd / (2 * j + 1);
        odd *= z * z;
    }
}

double size_of(const Model& model, double v) { return std::sqrt(v * v + model.slow * model.slow); }

double rate_of(const Model& model, const State& x, double v) {
    return (std::max(x[3], 0.0) + std::max(x[4], 0.0) / size_of(model, v)) / model.inertia;
}

double acceleration(const Model& model, const State& x, double torque, const Terms& f, double v) {
    const double other = std::min(x[4], 0.0) * v / size_of(model, v) + std::min(x[3], 0.0) * v;
    return (x[2] * torque + f.dot(x.tail<TERMS>()) - other) / model.inertia;
}

// Derivatives of one stage, from those of the angle and velocity at which its acceleration is taken.
void stage(const Model& model, const State& x, double torque, const Terms& f, const Terms& g, double at, double v,
           double a, const Factors& by, Slopes& J) {
    const double size = size_of(model, at), cube = size * size * size;
    const double by_velocity = std::min(x[4], 0.0) * model.slow * model.slow / cube + std::min(x[3], 0.0);
    Slopes::RowXpr angle = J.row(0), velocity = J.row(1);
    Eigen::Matrix<double, 1, M> slope = -g.dot(x.tail<TERMS>()) * angle - by_velocity * velocity;
    slope.tail<TERMS>() += f.transpose();
    slope[2] += torque;
    if (x[4] < 0.0) slope[4] -= at / size;
    if (x[3] < 0.0) slope[3] -= at;
    slope /= model.inertia;
    Eigen::Matrix<double, 1, M> of_rate = -std::max(x[4], 0.0) * at / cube * velocity;
    if (x[3] >= 0.0) of_rate[3] += 1.0;
    if (x[4] >= 0.0) of_rate[4] += 1.0 / size;
    of_rate /= model.inertia;
    angle = by.second * slope + (by.first_slope * v + by.second_slope * a) * of_rate;
    velocity = by.first * slope + (by.keep_slope * v + by.first_slope * a) * of_rate;
    angle[0] += 1.0;
    angle[1] += by.first;
    velocity[1] += by.keep;
}
}  // namespace

// steps (count, 5): step [s], q before and after, torque, measured angle; x (8,) and diagonal (8,) of P at the start,
// settings: deflection scale, B_0, v_s, torque noise, position noise -> x (8,) after the last step.
extern "C" void ekf(const double* steps, long count, const double* start, const double* diagonal,
                    const double* settings, double* result) {
    const Model model{settings[0], settings[1], settings[2]};
    const double torque_variance = settings[3] * settings[3], blur = settings[4] * settings[4];
    State x = Eigen::Map<const State>(start);
    Covariance P = Eigen::Map<const State>(diagonal).asDiagonal();
    Terms f, g;
    for (long k = 0; k < count; ++k) {
        const double* row = steps + 5 * k;
        const double T = row[0], torque = row[3], theta = x[0], v = x[1], h = 0.5 * T;
        spring(model, row[1] - theta, f, g);
        const double stiffness = g.dot(x.tail<TERMS>()), slow = model.slow * model.slow;
        const double of_stiffness = g.dot(P.bottomRightCorner<TERMS, TERMS>() * g);
        const double of_angle = P(0, 0) + h * (2.0 * P(0, 1) + h * P(1, 1));
        const double sign = std::min(P(1, 1) * slow * slow / std::pow(v * v + slow, 3), 1.0);
        const double variance =
            ((x[2] * x[2] + P(2, 2)) * torque_variance + stiffness * stiffness * blur +
             std::max(of_stiffness, 0.0) * (blur + of_angle) + P(3, 3) * P(1, 1) + P(4, 4) * sign) /
            (model.inertia * model.inertia);
        Slopes J = Slopes::Zero();
        J(0, 0) = J(1, 1) = 1.0;
        const Factors half(rate_of(model, x, v), h);
        double a = acceleration(model, x, torque, f, v);
        const double middle = theta + half.first * v + half.second * a, w = half.keep * v + half.first * a;
        stage(model, x, torque, f, g, v, v, a, half, J);
        const Factors whole(rate_of(model, x, w), T);
        spring(model, 0.5 * (row[1] + row[2]) - middle, f, g);
        a = acceleration(model, x, torque, f, w);
        stage(model, x, torque, f, g, w, v, a, whole, J);
        x[0] = theta + whole.first * v + whole.second * a;
        x[1] = whole.keep * v + whole.first * a;
        const Slopes JP = J * P;
        P.topRows<2>() = JP;
        P.leftCols<2>() = JP.transpose();
        P.topLeftCorner<2, 2>() = JP * J.transpose();
        const Factors after(rate_of(model, x, x[1]), T);
        const Eigen::Vector2d G(after.second, after.first);
        P.topLeftCorner<2, 2>() += variance * G * G.transpose();
        const double S = P(0, 0) + blur;
        const State K = P.col(0) / S;
        x += K * (row[4] - x[0]);
        P -= K * P.row(0).eval();
        P += (blur * K - P.col(0).eval()) * K.transpose();
        P = (0.5 * (P + P.transpose())).eval();
    }
    Eigen::Map<State>(result, M) = x;
}
