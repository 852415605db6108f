#include "contact/models/lcp_pgs.h"

namespace saltus {

GaussSeidelSweeps::GaussSeidelSweeps(std::span<const double> A, std::span<const double> b,
                                     std::span<const double> friction, std::span<const int> kind, int sweeps,
                                     std::pmr::memory_resource* memory)
    : A_(A),
      x_(b.size(), 0.0, memory),
      friction_(friction),
      kind_(kind),
      num_normals_(static_cast<int>(kind.size())),
      updates_(memory) {
  const int n = static_cast<int>(b.size());
  updates_.reserve(static_cast<std::size_t>(sweeps) * n);
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    for (int i = 0; i < n; ++i) {
      const double overwritten = x_[i];
      const double mu = i < num_normals_ ? 0 : friction_[kind_[i - num_normals_]];
      updates_.push_back({UpdateRow<double>(A_, b, mu, num_normals_, i, x_), overwritten});
    }
  }
}

LcpClass GaussSeidelSweeps::ClassOf(int row) const { return updates_[updates_.size() - x_.size() + row].kind; }

GaussSeidelSweeps::Derivative GaussSeidelSweeps::Reverse(int row) const {
  const int n = static_cast<int>(x_.size());
  std::pmr::memory_resource* const memory = updates_.get_allocator().resource();
  Derivative d{std::pmr::vector<double>(n * n, 0.0, memory),
               std::pmr::vector<double>(n, 0.0, memory),
               std::pmr::vector<double>(friction_.size(), 0.0, memory)};
  std::pmr::vector<double> x(x_, memory), cotangent(n, 0.0, memory);
  cotangent[row] = 1;
  for (int k = static_cast<int>(updates_.size()) - 1; k >= 0; --k) {
    const int i = k % n;
    const double assigned = x[i], g = cotangent[i];
    x[i] = updates_[k].overwritten;
    cotangent[i] = 0;
    switch (updates_[k].kind) {
      case LcpClass::kClamping: {
        const double w = g / A_[i * n + i];
        d.by_b[i] += w;
        d.by_A[i * n + i] -= w * assigned;
        for (int j = 0; j < n; ++j) {
          if (j == i) continue;
          d.by_A[i * n + j] -= w * x[j];
          cotangent[j] -= w * A_[i * n + j];
        }
        break;
      }
      case LcpClass::kUpperBound:
      case LcpClass::kLowerBound: {
        const double sign = updates_[k].kind == LcpClass::kUpperBound ? 1 : -1;
        const int kind = kind_[i - num_normals_];
        cotangent[i - num_normals_] += sign * friction_[kind] * g;
        d.by_friction[kind] += sign * x[i - num_normals_] * g;
        break;
      }
      case LcpClass::kFree:
        break;
    }
  }
  return d;
}

}  // namespace saltus
