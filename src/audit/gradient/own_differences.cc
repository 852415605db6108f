#include "audit/gradient/own_differences.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include "base/parallel_for.h"
#include "saltus/control/single_shooting.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/scene_parameter.h"
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
constexpr int kMostDiscs = 16;       // of a scene whose parameters are compared
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// The loss of a model as a function of some of its variables.
class Loss {
 public:
  Loss(const Contact& contact, const Scene& scene, SingleShooting::Variables variables, const StopRequest& stop,
       SingleShooting::OfScene of_scene = nullptr)
      : shooting_(MakeSimulator(contact, scene, Precision::kDouble), variables, std::move(of_scene)),
        gradient_(shooting_.num_variables()) {
    shooting_.set_stop(stop);
    ok_ = shooting_.Evaluate(shooting_.initial_guess(), &value_, gradient_.data());
  }

  bool ok() const { return ok_; }
  int num_variables() const { return shooting_.num_variables(); }
  double value() const { return value_; }
  const std::vector<double>& gradient() const { return gradient_; }
  const SingleShooting& shooting() const { return shooting_; }

  // Returns the loss at a distance along a direction, NaN where it fails.
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

// Compares the gradient along a direction with differences. `widest` is in the units of the direction.
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
  std::array<bool, 2> exists = {false, false};  // the loss, on either side: a parameter may be at a bound
  int jumps = 0;                                // widths on end at which the loss jumps on both sides
  double width = widest;
  for (int i = 0; i < kWidths && jumps < kMostJumps && !loss->shooting().stopped(); ++i, width *= kNarrower) {
    bool jumps_here = true;
    for (int side = 0; side < 2; ++side) {
      const double signed_width = side == 0 ? width : -width;
      const double change = loss->At(direction, signed_width) - loss->value();
      exists[side] = exists[side] || !std::isnan(change);
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
  if ((settled[0] || !exists[0]) && (settled[1] || !exists[1]) && (settled[0] || settled[1])) {
    found.agreement = Agreement::kDiffers;
    found.difference = 0.5 * (settled[0].value_or(*settled[1]) + settled[1].value_or(*settled[0]));
  }
  return found;
}

// Returns the distance that discs move in a step, m.
double LengthOfStep(const Scene& scene, const Simulator& simulator, int most_states = 0) {
  double smallest_radius = scene.bodies[0].radius;
  for (const Body& body : scene.bodies) smallest_radius = std::min(smallest_radius, body.radius);
  return std::max(LargestSpeed(simulator, most_states) * simulator.step(), 1e-3 * smallest_radius);
}

// Returns the size of a small change of a parameter; `length` is the distance that discs move in a step.
double ScaleOf(const SceneParameter& parameter, const Scene& scene, double length) {
  using Kind = SceneParameter::Kind;
  const double value = std::abs(ValueOf(parameter, scene));
  switch (parameter.kind) {
    case Kind::kMass:
    case Kind::kStiffness:
      return value > 0 ? value : 1.0;
    case Kind::kDamping:
      return value > 0 ? value : std::max(1.0, std::sqrt(scene.contact.stiffness));
    case Kind::kGravity:
      return length / (scene.duration * scene.duration);
    case Kind::kRadius:
    case Kind::kPosition:
    case Kind::kPlaneOffset:
    case Kind::kSegmentOffset:
      return length;
    default:
      return 1;
  }
}

struct Direction {
  Quantity quantity = Quantity::kPosition;
  std::vector<double> along;  // again and again over the variables
  double widest = 0;
};

// For each of several threads, the losses that its directions need.
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

// Returns the worse of the two.
OwnDifferences Worse(const OwnDifferences& a, const OwnDifferences& b) {
  const auto badness = [](const OwnDifferences& found) {
    return found.agreement == Agreement::kDiffers ? 2 : found.agreement == Agreement::kUndecided ? 1 : 0;
  };
  return badness(b) > badness(a) ? b : a;
}

}  // namespace

OwnDifferences CompareWithOwnDifferences(const Contact& contact, const Scene& scene, const StopRequest& stop,
                                         int threads, int most_states) {
  OwnDifferences worst;
  if (!WhyNotApplicable(contact, scene).empty()) return worst;
  LossesOfThreads losses(contact, scene, stop, threads);
  const Loss& by_state = losses.At(0, Quantity::kPosition);
  if (!by_state.ok()) return worst;
  const double T = scene.duration;
  const Simulator& simulator = by_state.shooting().simulator();
  double smallest_mass = std::numeric_limits<double>::infinity();
  for (int body : scene.control.bodies) smallest_mass = std::min(smallest_mass, scene.bodies[body].mass);
  const double length = LengthOfStep(scene, simulator, most_states);

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

std::vector<std::string> ParametersToCompare(const Scene& scene) {
  using Kind = SceneParameter::Kind;
  if (scene.num_bodies() > kMostDiscs) return {};
  std::vector<std::string> names;
  const std::vector<int> pairs = PairsInUse(scene);
  for (const int pair : pairs) names.push_back(NameOf({Kind::kRestitution, -1, pair}, scene));
  names.insert(names.end(), {"stiffness", "damping", "gravity"});
  // At zero friction the loss has only a right derivative with respect to friction.
  for (const int pair : pairs) {
    const SceneParameter friction{Kind::kFriction, -1, pair};
    if (ValueOf(friction, scene) > 0) names.push_back(NameOf(friction, scene));
  }
  for (const Body& body : scene.bodies) {
    if (!body.fixed) names.push_back("mass." + body.name);
  }
  for (const DesignParameter& design : scene.design) names.push_back(NameOf(design.parameter, scene));
  return names;
}

std::vector<ParameterAudit> CompareParameters(const Contact& contact, const Scene& scene,
                                              const std::vector<std::string>& names, const StopRequest& stop) {
  std::vector<ParameterAudit> audits;
  Scene designed = scene;
  designed.optimize = Optimize::kNone;
  designed.design.clear();
  for (const std::string& name : names) {
    for (const SceneParameter& parameter : ParametersNamed(name, scene)) {
      if (!std::ranges::count(designed.design, DesignParameter{parameter})) designed.design.push_back({parameter});
    }
  }
  if (designed.design.empty() || !WhyNotApplicable(contact, designed).empty()) return audits;
  const auto of_scene = [&](const Scene& other) {
    return WhyNotApplicable(contact, other).empty() ? MakeSimulator(contact, other, Precision::kDouble) : nullptr;
  };
  Loss loss(contact, designed, SingleShooting::Variables::kOfScene, stop, of_scene);
  if (!loss.ok() || loss.num_variables() != static_cast<int>(designed.design.size())) return audits;
  const double length = LengthOfStep(scene, loss.shooting().simulator());
  for (int i = 0; i < loss.num_variables() && !loss.shooting().stopped(); ++i) {
    const SceneParameter& parameter = designed.design[i].parameter;
    std::vector<double> along(loss.num_variables(), 0.0);
    along[i] = 1;
    const OwnDifferences found = Compare(&loss, along, kWidest * ScaleOf(parameter, scene, length));
    ParameterAudit audit{NameOf(parameter, scene), found.gradient, std::nullopt};
    if (found.agreement != Agreement::kUndecided) audit.difference = found.difference;
    if (found.gradient == 0 && audit.difference.value_or(0) == 0) continue;
    if (found.agreement == Agreement::kAgrees) audit.verdict = Verdict::kRight;
    if (found.agreement == Agreement::kDiffers) {
      audit.verdict = found.gradient * found.difference < 0 ? Verdict::kWrongSign : Verdict::kWrong;
    }
    audits.push_back(std::move(audit));
  }
  return audits;
}

double LargestSpeed(const Simulator& simulator, int most_states) {
  double largest = 0;
  std::vector<double> x(simulator.state_size());
  const int steps = simulator.num_steps(), stride = most_states > 0 ? std::max(1, steps / most_states) : 1;
  for (int k = steps; k >= 0; k -= stride) {
    simulator.GetState(k, x);
    for (int i = 0; i < simulator.num_bodies(); ++i) {
      const double* v = &x[i * simulator.body_size() + 2];
      largest = std::max(largest, std::hypot(v[0], v[1]));
    }
  }
  return largest;
}

}  // namespace saltus
