#include "saltus/audit/external_gradient.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "base/statistics.h"
#include "saltus/audit/audit.h"
#include "saltus/control/control_rows.h"

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

std::vector<ExternalGradientEntry> JudgeExternalGradient(const Scene& scene, const ExternalGradient& given,
                                                         const ModelGradient& exact) {
  CHECK(exact.ok());
  CHECK_EQ(static_cast<int>(exact.gradient.initial.size()), InitialSize(scene));
  CHECK_EQ(static_cast<int>(exact.gradient.control.size()), scene.control_width() * exact.num_steps);
  std::vector<ExternalGradientEntry> entries;
  // Adds a number that is known. Derivatives by a torque are judged as those by the force at the radius that makes it.
  const auto add = [&](const std::string& name, double value, double at, double largest, double radius = 1) {
    if (std::isnan(value)) return;
    const Verdict verdict = Judge(value * radius, at, largest, given.tolerance);
    entries.push_back({name, value, at / radius, exact.ambiguous.empty() ? verdict : Verdict::kAmbiguous});
  };
  for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity}) {
    const bool position = quantity == Quantity::kPosition;
    const std::vector<double>& values = position ? given.position : given.velocity;
    CHECK_LE(values.size(), 2 * scene.bodies.size());
    const double largest = Largest(EntriesOf(scene, exact, quantity, 1));
    for (size_t i = 0; i < values.size(); ++i) {
      const Body& body = scene.bodies[i / 2];
      const std::string name = std::string(position ? "p" : "v") + (i % 2 == 0 ? "x " : "y ") + body.name;
      const double at = exact.gradient.initial[4 * (i / 2) + (position ? 0 : 2) + i % 2];
      if (!body.fixed) add(name, values[i], at, largest);
    }
  }
  for (const bool angle : {true, false}) {
    const std::vector<double>& values = angle ? given.angle : given.angular_velocity;
    CHECK(values.empty() || (scene.Spins() && values.size() <= scene.bodies.size()));
    std::vector<double> all;  // of all discs
    for (size_t i = 0; i < scene.bodies.size() && scene.Spins(); ++i) {
      all.push_back(exact.gradient.initial[4 * scene.bodies.size() + kSpin * i + (angle ? 0 : 1)]);
    }
    for (size_t i = 0; i < values.size(); ++i) {
      const Body& body = scene.bodies[i];
      if (body.Spins()) add((angle ? "angle " : "angular velocity ") + body.name, values[i], all[i], Largest(all));
    }
  }
  if (given.control.empty()) return entries;
  const int intervals = given.intervals > 0 ? given.intervals : exact.num_steps;
  const int columns = ControlColumns(scene), width = columns * scene.num_controlled();
  const int given_intervals = static_cast<int>(given.control.size()) / width;
  CHECK_LE(given_intervals, intervals);
  const std::vector<double> control = CoarsenControl(exact.gradient.control, exact.num_steps, intervals);
  const double largest = Largest(control);
  const auto of = [&](int k, int body) { return "[" + std::to_string(k) + "] " + scene.bodies[body].name; };
  for (int k = 0; k < given_intervals; ++k) {
    for (int c = 0; c < scene.num_controlled(); ++c) {
      const double *row = &given.control[k * width + c * columns], *at = &control[scene.ForceIndex(k, c)];
      for (int j = 0; j < 2; ++j) add((j == 0 ? "ux" : "uy") + of(k, scene.control.bodies[c]), row[j], at[j], largest);
    }
  }
  for (int k = 0; k < given_intervals; ++k) {
    for (int t = 0; t < scene.num_torques(); ++t) {
      const int body = scene.control.torque_bodies[t];
      const auto c = std::ranges::find(scene.control.bodies, body) - scene.control.bodies.begin();
      const double torque = given.control[k * width + c * columns + 2], at = control[scene.TorqueIndex(k, t)];
      add("torque" + of(k, body), torque, at, largest, scene.bodies[body].radius);
    }
  }
  return entries;
}

Verdict WorstVerdict(const std::vector<ExternalGradientEntry>& entries) {
  Verdict worst = entries.empty() ? Verdict::kUnknown : Verdict::kRight;
  for (const ExternalGradientEntry& entry : entries) worst = std::max(worst, entry.verdict);
  return worst;
}

}  // namespace saltus
