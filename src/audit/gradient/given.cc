#include "saltus/audit/given.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "base/statistics.h"
#include "saltus/audit/audit.h"

namespace saltus {
namespace {

constexpr double kTolerance = 1e-6;   // of a right entry, relative to the largest of its quantity
constexpr double kNegligible = 1e-3;  // likewise; smaller ones may have any sign

Verdict Judge(double given, double exact, double largest, double tolerance) {
  if (std::abs(given - exact) <= std::max(tolerance, kTolerance * largest)) return Verdict::kRight;
  const double least = std::min(std::abs(given), std::abs(exact));
  return given * exact < 0 && least > kNegligible * largest ? Verdict::kWrongSign : Verdict::kWrong;
}

}  // namespace

std::vector<GivenEntry> JudgeGiven(const Scene& scene, const GivenGradient& given, const ModelGradient& exact) {
  CHECK(exact.ok());
  CHECK_EQ(static_cast<int>(exact.gradient.initial.size()), InitialSize(scene));
  CHECK_EQ(static_cast<int>(exact.gradient.control.size()), scene.control_width() * exact.num_steps);
  std::vector<GivenEntry> entries;
  const auto judge = [&](double value, double at, double largest) {
    return exact.ambiguous.empty() ? Judge(value, at, largest, given.tolerance) : Verdict::kAmbiguous;
  };
  // Judges the given entries of one vector; `values` and `at` name the exact ones.
  const auto add = [&](const std::optional<Vec2d>& value,
                       const std::string& name,
                       const std::string& of,
                       const double* at,
                       double largest) {
    for (int j = 0; value && j < 2; ++j) {
      entries.push_back({name + (j == 0 ? "x" : "y") + of, (*value)[j], at[j], judge((*value)[j], at[j], largest)});
    }
  };
  for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity}) {
    const bool position = quantity == Quantity::kPosition;
    const auto& values = position ? given.position : given.velocity;
    CHECK_LE(static_cast<int>(values.size()), scene.num_bodies());
    const double largest = Largest(EntriesOf(scene, exact, quantity, 1));
    for (size_t i = 0; i < values.size(); ++i) {
      if (scene.bodies[i].fixed) continue;
      add(values[i],
          position ? "p" : "v",
          " " + scene.bodies[i].name,
          &exact.gradient.initial[4 * i + (position ? 0 : 2)],
          largest);
    }
  }
  const int intervals = given.intervals > 0 ? given.intervals : exact.num_steps;
  CHECK_LE(static_cast<int>(given.control.size()), intervals);
  const std::vector<double> control = CoarsenControl(exact.gradient.control, exact.num_steps, intervals);
  const double largest = Largest(control);
  for (size_t k = 0; k < given.control.size(); ++k) {
    CHECK_LE(static_cast<int>(given.control[k].size()), scene.num_controlled());
    for (size_t c = 0; c < given.control[k].size(); ++c) {
      add(given.control[k][c],
          "u",
          "[" + std::to_string(k) + "] " + scene.bodies[scene.control.bodies[c]].name,
          &control[scene.ForceIndex(k, c)],
          largest);
    }
  }
  for (size_t k = 0; k < given.torque.size(); ++k) {
    for (size_t t = 0; t < given.torque[k].size(); ++t) {
      if (!given.torque[k][t]) continue;
      const Body& body = scene.bodies[scene.control.turned[t]];
      const double by_force = *given.torque[k][t] * body.radius, at = control[scene.TurnIndex(k, static_cast<int>(t))];
      entries.push_back({"torque[" + std::to_string(k) + "] " + body.name,
                         *given.torque[k][t],
                         at / body.radius,
                         judge(by_force, at, largest)});
    }
  }
  return entries;
}

Verdict WorstOf(const std::vector<GivenEntry>& entries) {
  Verdict worst = entries.empty() ? Verdict::kUnknown : Verdict::kRight;
  for (const GivenEntry& entry : entries) worst = std::max(worst, entry.verdict);
  return worst;
}

}  // namespace saltus
