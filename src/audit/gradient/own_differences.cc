#include "audit/gradient/own_differences.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <random>
#include <vector>

#include "audit/gradient/statistics.h"
#include "base/parallel_for.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr int kDirections = 2;  // of each quantity
constexpr double kWidest = 0.1,
                 kNarrower = 0.1;  // widths in grid widths (width_sweep.h), each so much less than the last
constexpr int kWidths = 8;
constexpr double kTolerance = 1e-3;  // relative, by which a gradient may miss its differences
constexpr double kSettled = 0.1;     // of the miss, by which slopes of neighbouring widths may differ
constexpr double kJumps = 0.5;       // of the change of loss over a width, that over the next: it does not vanish
constexpr int kMostJumps = 3;        // widths in a row
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
  std::array<double, 2> change_before = {kNan, kNan};
  int jumps = 0;  // widths on end at which the loss jumps on both sides
  double width = widest;
  for (int i = 0; i < kWidths && jumps < kMostJumps && !loss->shooting().stopped(); ++i, width *= kNarrower) {
    bool jumps_here = true;
    for (int side = 0; side < 2; ++side) {
      const double signed_width = side == 0 ? width : -width;
      const double change = loss->At(direction, signed_width) - loss->value();
      jumps_here = jumps_here && std::abs(change) >= kJumps * std::abs(change_before[side]);
      change_before[side] = change;
      const double slope = change / signed_width;
      const double miss = std::abs(slope - found.gradient);
      if (miss <= kTolerance * std::max(scale, std::abs(slope))) {
        found.agreement = Agreement::kAgrees;
        found.difference = slope;
        return found;
      }
      if (std::abs(slope - before[side]) <= kSettled * miss) settled[side] = slope;
      before[side] = slope;
    }
    jumps = jumps_here ? jumps + 1 : 0;
  }
  if (settled[0] && settled[1]) {
    found.agreement = Agreement::kDiffers;
    found.difference = 0.5 * (*settled[0] + *settled[1]);
  }
  return found;
}

struct Direction {
  Quantity quantity = Quantity::kPosition;
  std::vector<double> along;  // again and again over the variables
  double widest = 0;
};

// Of each of several threads the losses that its directions need.
class LossesOfThreads {
 public:
  LossesOfThreads(const Contact& contact, const Scene& scene, const StopRequest& stop, int threads)
      : contact_(contact), scene_(scene), controlled_(scene), stop_(stop), losses_(threads) {
    controlled_.optimize = Optimize::kControl;
  }
  Loss& At(int thread, Quantity quantity) {
    const bool control = quantity == Quantity::kControl;
    std::unique_ptr<Loss>& loss = control ? losses_[thread].by_control : losses_[thread].by_state;
    if (loss == nullptr) {
      const auto variables = control ? SingleShooting::Variables::kOfScene : SingleShooting::Variables::kInitialState;
      loss = std::make_unique<Loss>(contact_, control ? controlled_ : scene_, variables, stop_);
    }
    return *loss;
  }

 private:
  struct Losses {
    std::unique_ptr<Loss> by_state, by_control;
  };
  const Contact& contact_;
  const Scene& scene_;
  Scene controlled_;
  const StopRequest& stop_;
  std::vector<Losses> losses_;
};

// The worse of the two.
OwnDifferences Worse(const OwnDifferences& a, const OwnDifferences& b) {
  const auto badness = [](const OwnDifferences& found) {
    return found.agreement == Agreement::kDiffers ? 2 : found.agreement == Agreement::kUndecided ? 1 : 0;
  };
  return badness(b) > badness(a) ? b : a;
}

}  // namespace

OwnDifferences CompareWithOwnDifferences(const Contact& contact, const Scene& scene, const StopRequest& stop,
                                         int threads) {
  OwnDifferences worst;
  if (!WhyNotApplicable(contact, scene).empty()) return worst;
  LossesOfThreads losses(contact, scene, stop, threads);
  const Loss& by_state = losses.At(0, Quantity::kPosition);
  if (!by_state.ok()) return worst;
  const double T = scene.duration;
  const Simulator& simulator = by_state.shooting().simulator();
  double smallest_radius = scene.bodies[0].radius, smallest_mass = std::numeric_limits<double>::infinity();
  for (const Body& body : scene.bodies) smallest_radius = std::min(smallest_radius, body.radius);
  for (int body : scene.control.bodies) smallest_mass = std::min(smallest_mass, scene.bodies[body].mass);
  const double length = std::max(LargestSpeed(simulator) * simulator.step(), 1e-3 * smallest_radius);

  std::mt19937 random(1);
  const auto sign = [&] { return random() % 2 == 0 ? 1.0 : -1.0; };
  std::vector<Direction> directions;
  const int half = by_state.num_variables() / 2;  // positions, then velocities
  for (int n = 0; n < kDirections; ++n) {
    for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity}) {
      const bool position = quantity == Quantity::kPosition;
      std::vector<double> along(2 * half, 0.0);
      for (int i = 0; i < half; ++i) along[position ? i : half + i] = sign();
      directions.push_back({quantity, std::move(along), kWidest * (position ? length : length / T)});
    }
  }
  for (int n = 0; n < kDirections && !scene.control.bodies.empty(); ++n) {
    std::vector<double> row(scene.control_width());
    for (double& entry : row) entry = sign();
    directions.push_back({Quantity::kControl, std::move(row), kWidest * 2 * length * smallest_mass / (T * T)});
  }

  const int count = static_cast<int>(directions.size());
  std::vector<std::optional<OwnDifferences>> found(count);
  std::atomic<int> differs = count;  // none is worse, so what follows it is not needed
  ParallelFor(threads, count, [&](int thread, int i) {
    if (i > differs) return;
    const Direction& direction = directions[i];
    Loss& loss = losses.At(thread, direction.quantity);
    if (!loss.ok()) return;
    std::vector<double> along(loss.num_variables());
    for (std::size_t j = 0; j < along.size(); ++j) along[j] = direction.along[j % direction.along.size()];
    found[i] = Compare(&loss, along, direction.widest);
    found[i]->quantity = direction.quantity;
    if (found[i]->agreement != Agreement::kDiffers) return;
    for (int other = differs; i < other && !differs.compare_exchange_weak(other, i);) continue;
  });
  worst.agreement = Agreement::kAgrees;
  for (int i = 0; i <= std::min<int>(differs, count - 1); ++i) {
    if (found[i]) worst = Worse(worst, *found[i]);
  }
  return worst;
}

}  // namespace saltus
