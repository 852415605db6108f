#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include "audit/gradient/step_study.h"
#include "saltus/control/single_shooting.h"

namespace saltus {
namespace {

// Widths of differences, in natural units; each so much less than the last. Moved along each other by w, two discs meet
// later by w^2, which must be more than rounding: what comes first decides the slope.
constexpr double kWidest = 1e-3, kNarrower = 0.1;
constexpr int kWidths = 3;
constexpr double kTolerance = 1e-5;  // by which an entry may miss its differences, of the largest of its quantity
constexpr double kSmooth = 1e-6;     // likewise, by which extrapolations of differences may differ
constexpr double kLinear = 1;        // change of the loss, natural units: of more, differences say nothing
constexpr double kAside = 1e-8;      // by which the initial state moves, natural units
constexpr double kMostWork = 1e6;    // entries times (discs times steps, and so many for each impact)
constexpr double kImpactWork = 100;

// Returns the impacts of the last rollout with their modes, in their order.
std::vector<Touch> ImpactsOf(const Simulator& simulator) {
  std::vector<Touch> impacts;
  for (const StepTouch& at : simulator.touches()) {
    if (at.touch.kind == ContactKind::kImpact) impacts.push_back(at.touch);
  }
  return impacts;
}

// The number of impacts of a motion nearby that has others than this: where the initial state moves a little, they
// change their order, happen or not, or stick or slide. So it is where they happen at one time, where discs pass each
// other without a gap, and at the border between sticking and sliding. std::nullopt: there is no such motion.
std::optional<std::size_t> OtherImpactsNearby(SingleShooting* shooting) {
  const std::vector<Touch> here = ImpactsOf(shooting->simulator());
  const auto same = [](const Touch& l, const Touch& r) { return l.candidate == r.candidate && l.mode == r.mode; };
  for (const double phase : {0.7, 2.1}) {
    for (const double by : {-kAside, kAside}) {
      std::vector<double> z = shooting->initial_guess();
      for (std::size_t i = 0; i < z.size(); ++i) z[i] += by * std::cos(phase + 1.9 * static_cast<double>(i));
      double loss = 0;
      const bool ok = shooting->Evaluate(z, &loss, nullptr);
      const std::vector<Touch> there = ImpactsOf(shooting->simulator());
      if (!ok || !std::ranges::equal(here, there, same)) return there.size();
    }
  }
  return std::nullopt;
}

// Returns the entries in the order of SingleShooting's variables.
std::vector<OneSided> EntriesOf(const Scene& scene) {
  std::vector<OneSided> entries;
  for (const auto quantity : {OneSided::Quantity::kPosition, OneSided::Quantity::kVelocity}) {
    for (int i = 0; i < scene.num_bodies(); ++i) {
      for (int j = 0; j < 2 && !scene.bodies[i].fixed; ++j) entries.push_back({i, quantity, j});
    }
  }
  return entries;
}

class Sides {
 public:
  Sides(SingleShooting* shooting, double loss, std::vector<double> gradient)
      : shooting_(*shooting), loss_(loss), gradient_(std::move(gradient)) {}

  // Returns the side on which the derivative holds; std::nullopt if it holds on both, or if differences do not decide.
  std::optional<OneSided::Side> FindSide(int variable, double scale) {
    const Found below = Follow(variable, -1, scale), above = Follow(variable, 1, scale);
    if (above.agrees && below.other) return OneSided::Side::kAbove;
    if (below.agrees && above.other) return OneSided::Side::kBelow;
    // The motion has other orders of impacts on both sides, perhaps the same one: moved across the line of centres, two
    // discs meet later whatever the side.
    return above.other && below.other ? std::optional(OneSided::Side::kNone) : std::nullopt;
  }

 private:
  struct Found {
    bool agrees = false;
    std::optional<double> other;  // the slope on which differences settle instead
  };
  // Follows slopes at w, w/2, w/4 and w/8, of which each three in a row give the value at 0 of a parabola.
  Found Follow(int variable, double sign, double scale) {
    Found found;
    double width = kWidest;
    for (int i = 0; i < kWidths; ++i, width *= kNarrower) {
      if (scale * width > kLinear) continue;
      std::array<double, 4> slopes;
      for (int k = 0; k < 4; ++k) {
        const double by = sign * std::ldexp(width, -k);
        std::vector<double> z = shooting_.initial_guess();
        z[variable] += by;
        double loss = 0;
        if (!shooting_.Evaluate(z, &loss, nullptr)) return {};
        slopes[k] = (loss - loss_) / by;
      }
      const auto at_zero = [&](int k) { return slopes[k] / 3 - 2 * slopes[k + 1] + slopes[k + 2] * 8 / 3; };
      const double slope = at_zero(1), size = scale + std::abs(slope);
      if (std::abs(slope - gradient_[variable]) <= kTolerance * size) return {.agrees = true, .other = {}};
      if (std::abs(slope - at_zero(0)) <= kSmooth * size) found.other = slope;
    }
    return found;
  }

  SingleShooting& shooting_;
  const double loss_;
  const std::vector<double> gradient_;
};

}  // namespace

std::vector<OneSided> OneSidedBySimultaneousEvents(const Contact& contact, const Scene& scene,
                                                   const std::vector<OneSided>& known, const StopRequest& stop) {
  std::vector<OneSided> found;
  SingleShooting shooting(MakeSimulator(contact, scene, Precision::kDouble), SingleShooting::Variables::kInitialState);
  shooting.set_stop(stop);
  std::vector<double> gradient(shooting.num_variables());
  double loss = 0;
  if (!shooting.Evaluate(shooting.initial_guess(), &loss, gradient.data())) return found;
  const std::vector<OneSided> entries = EntriesOf(scene);
  const auto is_too_much = [&](std::size_t impacts) {
    const double of_rollout =
        static_cast<double>(scene.num_bodies()) * scene.steps + kImpactWork * static_cast<double>(impacts);
    return static_cast<double>(entries.size()) * of_rollout > kMostWork;
  };
  if (is_too_much(ImpactsOf(shooting.simulator()).size())) return found;
  // Discs at rest have no impacts, but small changes may cause many.
  const std::optional<std::size_t> nearby = OtherImpactsNearby(&shooting);
  if (!nearby || is_too_much(*nearby)) return found;
  const auto largest = [&](OneSided::Quantity quantity) {
    double size = kTolerance * std::abs(loss);
    for (std::size_t i = 0; i < entries.size(); ++i) {
      if (entries[i].quantity == quantity) size = std::max(size, std::abs(gradient[i]));
    }
    return size;
  };
  const double by_position = largest(OneSided::Quantity::kPosition),
               by_velocity = largest(OneSided::Quantity::kVelocity);
  Sides sides(&shooting, loss, gradient);
  for (std::size_t i = 0; i < entries.size(); ++i) {
    const OneSided& entry = entries[i];
    const bool is_known = std::ranges::any_of(known, [&](const OneSided& other) {
      return other.body == entry.body && other.quantity == entry.quantity && other.component == entry.component;
    });
    if (is_known) continue;
    const bool position = entry.quantity == OneSided::Quantity::kPosition;
    const std::optional<OneSided::Side> side =
        sides.FindSide(static_cast<int>(i), position ? by_position : by_velocity);
    if (shooting.stopped()) return found;
    if (!side) continue;
    found.push_back(entry);
    found.back().side = *side;
  }
  return found;
}

}  // namespace saltus
