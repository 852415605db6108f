#include "saltus/control/objective.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "saltus/contact/step_input.h"
#include "simulate/wide_loops.h"

namespace saltus {
namespace {

// Returns how many entries of the state a term reads.
int Width(const TerminalTerm& term) { return term.IsRotational() ? 1 : 2; }

// Returns the index of the first entry that a term reads in a state of `size` numbers.
int Offset(const TerminalTerm& term, int body_size, std::size_t size) {
  CHECK(term.body >= 0 && (term.body + 1) * static_cast<std::size_t>(body_size) <= size)
      << "a terminal term of body " << term.body << ", which is not in the state";
  CHECK(!term.IsRotational() || body_size == 4 + kSpin) << "a terminal term of spin, which is not in the state";
  constexpr int kOffset[] = {0, 2, 4, 5};  // by quantity
  return term.body * body_size + kOffset[static_cast<int>(term.quantity)];
}

}  // namespace

std::string NonTerminalTerms(const Objective& objective) {
  if (!objective.running.empty()) return "running costs";
  if (!objective.via.empty()) return "waypoint costs";
  if (objective.duration) return "a free duration";
  return ConstraintsOf(objective);
}

std::string ConstraintsOf(const Objective& objective) {
  const auto has_region = [](const TerminalTerm& term) { return term.region.has_value(); };
  if (std::ranges::any_of(objective.terminal, has_region)) return "goal regions";
  if (!objective.limits.empty()) return "limits of the speed";
  return objective.HasConstraints() ? "terminal equality constraints" : "";
}

std::string NonTerminalFeatures(const Scene& scene) {
  if (std::string found = NonTerminalTerms(scene.objective); !found.empty()) return found;
  if (scene.control.IsBounded()) return "bounds on the control";
  return scene.no_contact.empty() ? "" : "pairs that must not touch";
}

double TerminalLoss(const Objective& objective, std::span<const double> x, int body_size) {
  double loss = 0;
  for (const TerminalTerm& term : objective.terminal) {
    if (term.hard) continue;
    const double* q = &x[Offset(term, body_size, x.size())];
    if (term.component) {
      loss += term.weight * q[*term.component];
    } else if (term.IsRotational()) {
      const double miss = *q - term.target[0];
      loss += term.weight * miss * miss;
    } else {
      const Vec2d miss(q[0] - term.target[0], q[1] - term.target[1]);
      loss += term.weight * Dot(miss, miss);
    }
  }
  return loss;
}

void TerminalGradient(const Objective& objective, std::span<const double> x, int body_size,
                      std::span<double> gradient) {
  CHECK_EQ(gradient.size(), x.size());
  std::fill(gradient.begin(), gradient.end(), 0.0);
  for (const TerminalTerm& term : objective.terminal) {
    if (term.hard) continue;
    const int at = Offset(term, body_size, x.size());
    if (term.component) {
      gradient[at + *term.component] += term.weight;
      continue;
    }
    for (int j = 0; j < Width(term); ++j) gradient[at + j] += 2 * term.weight * (x[at + j] - term.target[j]);
  }
}

int NumTerminalResiduals(const Objective& objective) {
  int rows = 0;
  for (const TerminalTerm& term : objective.terminal) rows += Width(term);
  return rows;
}

void TerminalResiduals(const Objective& objective, std::span<const double> x, int body_size,
                       std::span<double> residuals) {
  CHECK_EQ(static_cast<int>(residuals.size()), NumTerminalResiduals(objective));
  int row = 0;
  for (const TerminalTerm& term : objective.terminal) {
    const int at = Offset(term, body_size, x.size());
    for (int j = 0; j < Width(term); ++j) residuals[row++] = std::sqrt(term.weight) * (x[at + j] - term.target[j]);
  }
}

Eigen::MatrixXd TerminalJacobian(const Objective& objective, int state_size, int body_size) {
  Eigen::MatrixXd jacobian = Eigen::MatrixXd::Zero(NumTerminalResiduals(objective), state_size);
  int row = 0;
  for (const TerminalTerm& term : objective.terminal) {
    const int at = Offset(term, body_size, state_size);
    for (int j = 0; j < Width(term); ++j) jacobian(row++, at + j) = std::sqrt(term.weight);
  }
  return jacobian;
}

double EffortLoss(const Objective& objective, std::span<const double> control, double dt) {
  return objective.effort * SumsOfSquares<1>({control.data()}, control.size())[0] * dt;
}

void AddEffortGradient(const Objective& objective, std::span<const double> control, double dt,
                       std::span<double> gradient) {
  CHECK_EQ(gradient.size(), control.size());
  const double weight = EffortWeight(objective, dt);
  for (size_t i = 0; i < control.size(); ++i) gradient[i] += weight * control[i];
}

}  // namespace saltus
