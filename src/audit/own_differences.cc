#include "audit/own_differences.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "saltus/control/single_shooting.h"
#include "saltus/dynamics/registry.h"

namespace saltus {
namespace {

constexpr int kDirections = 2;  // of each quantity
constexpr double kWidest = 0.1,
                 kNarrower = 0.1;  // widths in grid widths (width_sweep.h), each so much less than the last
constexpr int kWidths = 8;
constexpr double kTolerance = 1e-3;  // relative, by which a gradient may miss its differences
constexpr double kSettled = 0.1;     // of the miss, by which slopes of neighbouring widths may differ
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// The loss of a model as a function of some of its variables.
class Loss {
 public:
  Loss(const Contact& contact, const Scene& scene, SingleShooting::Variables variables, const StopRequest& stop)
      : shooting_(MakeSimulator(contact, scene, Precision::kDouble), variables), gradient_(shooting_.num_variables()) {
    shooting_.set_stop(stop);
    ok_ = shooting_.Evaluate(shooting_.initial_guess(), &value_, gradient_.data());
  }

  bool ok() const { return ok_; }
  int num_variables() const { return shooting_.num_variables(); }
  double value() const { return value_; }
  const std::vector<double>& gradient() const { return gradient_; }
  const SingleShooting& shooting() const { return shooting_; }

  // Not a number where it fails.
  double At(const std::vector<double>& direction, double width) {
    std::vector<double> z = shooting_.initial_guess();
    for (std::size_t i = 0; i < z.size(); ++i) z[i] += width * direction[i];
    double loss = 0;
    return shooting_.Evaluate(z, &loss, nullptr) ? loss : kNan;
  }

 private:
  SingleShooting shooting_;
  double value_ = 0;
  std::vector<double> gradient_;
  bool ok_ = false;
};

// The speed that a disc has at most in the last rollout, m/s.
double LargestSpeed(const Simulator& simulator) {
  double largest = 0;
  std::vector<double> x(simulator.state_size());
  for (int k = 0; k <= simulator.num_steps(); ++k) {
    simulator.GetState(k, x);
    for (int i = 0; i < simulator.num_bodies(); ++i) {
      const double* v = &x[i * simulator.body_size() + 2];
      largest = std::max(largest, std::hypot(v[0], v[1]));
    }
  }
  return largest;
}

// What a direction shows. `widest` is in its units.
OwnDifferences Compare(Loss* loss, const std::vector<double>& direction, double widest) {
  OwnDifferences found;
  double scale = 0;  // so that entries that happen to cancel do not ask for more than there is
  for (std::size_t i = 0; i < direction.size(); ++i) {
    found.gradient += loss->gradient()[i] * direction[i];
    scale += std::pow(loss->gradient()[i] * direction[i], 2);
  }
  scale = std::max(std::sqrt(scale), std::abs(found.gradient));
  std::array<double, 2> before = {kNan, kNan};
  std::array<std::optional<double>, 2> settled;  // on another slope, on either side
  double width = widest;
  for (int i = 0; i < kWidths; ++i, width *= kNarrower) {
    for (int side = 0; side < 2; ++side) {
      const double signed_width = side == 0 ? width : -width;
      const double slope = (loss->At(direction, signed_width) - loss->value()) / signed_width;
      const double miss = std::abs(slope - found.gradient);
      if (miss <= kTolerance * std::max(scale, std::abs(slope))) {
        found.agreement = Agreement::kAgrees;
        found.difference = slope;
        return found;
      }
      if (std::abs(slope - before[side]) <= kSettled * miss) settled[side] = slope;
      before[side] = slope;
    }
  }
  if (settled[0] && settled[1]) {
    found.agreement = Agreement::kDiffers;
    found.difference = 0.5 * (*settled[0] + *settled[1]);
  }
  return found;
}

// The worse of the two.
OwnDifferences Worse(const OwnDifferences& a, const OwnDifferences& b) {
  const auto badness = [](const OwnDifferences& found) {
    return found.agreement == Agreement::kDiffers ? 2 : found.agreement == Agreement::kUndecided ? 1 : 0;
  };
  return badness(b) > badness(a) ? b : a;
}

}  // namespace

OwnDifferences CompareWithOwnDifferences(const Contact& contact, const Scene& scene, const StopRequest& stop) {
  OwnDifferences worst;
  if (!WhyNotApplicable(contact, scene).empty()) return worst;
  Loss by_state(contact, scene, SingleShooting::Variables::kInitialState, stop);
  if (!by_state.ok()) return worst;
  const double T = scene.duration;
  const Simulator& simulator = by_state.shooting().simulator();
  double smallest_radius = scene.bodies[0].radius, smallest_mass = std::numeric_limits<double>::infinity();
  for (const Body& body : scene.bodies) smallest_radius = std::min(smallest_radius, body.radius);
  for (int body : scene.control.bodies) smallest_mass = std::min(smallest_mass, scene.bodies[body].mass);
  const double length = std::max(LargestSpeed(simulator) * simulator.step(), 1e-3 * smallest_radius);

  std::mt19937 random(1);
  const auto sign = [&] { return random() % 2 == 0 ? 1.0 : -1.0; };
  worst.agreement = Agreement::kAgrees;
  const auto add = [&](OwnDifferences found, Quantity quantity) {
    found.quantity = quantity;
    worst = Worse(worst, found);
  };
  const int half = by_state.num_variables() / 2;  // positions, then velocities
  for (int n = 0; n < kDirections; ++n) {
    for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity}) {
      const bool position = quantity == Quantity::kPosition;
      std::vector<double> direction(2 * half, 0.0);
      for (int i = 0; i < half; ++i) direction[position ? i : half + i] = sign();
      add(Compare(&by_state, direction, kWidest * (position ? length : length / T)), quantity);
    }
  }
  if (scene.control.bodies.empty()) return worst;
  Scene controlled = scene;
  controlled.optimize = Optimize::kControl;
  Loss by_control(contact, controlled, SingleShooting::Variables::kOfScene, stop);
  for (int n = 0; n < kDirections && by_control.ok(); ++n) {
    std::vector<double> row(scene.control_width()), direction(by_control.num_variables());
    for (double& entry : row) entry = sign();
    for (std::size_t i = 0; i < direction.size(); ++i) direction[i] = row[i % row.size()];
    add(Compare(&by_control, direction, kWidest * 2 * length * smallest_mass / (T * T)), Quantity::kControl);
  }
  return worst;
}

}  // namespace saltus
