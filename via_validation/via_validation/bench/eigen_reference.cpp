// The recursions of via_estimators.rls and via_estimators.qr with Eigen's matrices of fixed size: the same arithmetic,
// folded over a whole log. What a hand-written C++ estimator would cost.
#include <Eigen/Dense>
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
