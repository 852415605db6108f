#include "campaign/checks.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <span>

#include "contact/random_scene.h"
#include "saltus/control/objective.h"
#include "saltus/scene/walls.h"
#include "saltus/simulate/events.h"
#include "saltus/simulate/one_sided_derivatives.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"

namespace saltus::campaign {
namespace {

constexpr double kTolerance = 1e-9;  // of the scene's length, energy or momentum

struct Differences {
  double width;      // m, m/s, N: of the first that are taken
  double smooth;     // how well extrapolations must agree, of the size of the derivative
  double agreement;  // and the gradient with them
};
constexpr Differences kAtImpacts{4e-6, 1e-6, 1e-5};
constexpr Differences kAtRest{4e-3, 1e-2, 2e-2};
constexpr double kFinest = 1e-12;             // m, m/s, N: what finer differences tell is rounding
constexpr double kFinestChange = 1e-5;        // of a loss by them
constexpr double kLargestChange = 1e-2;       // of a loss by any
constexpr double kSmallestDerivative = 1e-3;  // what the tolerances are at least relative to

Vec2d PositionOf(std::span<const double> x, int i) { return {x[4 * i], x[4 * i + 1]}; }
Vec2d VelocityOf(std::span<const double> x, int i) { return {x[4 * i + 2], x[4 * i + 3]}; }

// Numbers of x are in the shape of an initial state: rotations behind positions and velocities.
double AngularVelocityOf(const Scene& scene, std::span<const double> x, int i) {
  return scene.bodies[i].Spins() ? x[4 * scene.bodies.size() + kSpin * i + 1] : 0.0;
}

double SpinInertia(const Body& body) { return body.Spins() ? body.MomentOfInertia() : 0.0; }

// The largest overlap of discs with each other or with walls, m.
double LargestOverlap(const Scene& scene, const std::vector<WallPart>& walls, std::span<const double> x) {
  double overlap = 0;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Body& body = scene.bodies[i];
    for (int j = 0; j < i; ++j) {
      if (body.fixed && scene.bodies[j].fixed) continue;
      const double distance = (PositionOf(x, i) - PositionOf(x, j)).norm();
      overlap = std::max(overlap, body.radius + scene.bodies[j].radius - distance);
    }
    for (const WallPart& wall : walls) {
      if (body.fixed || !wall.extent.Covers(PositionOf(x, i))) continue;
      overlap = std::max(overlap, body.radius - wall.LeastDistance(PositionOf(x, i)));
    }
  }
  return overlap;
}

// Returns the size of the box around all discs at the initial time, m.
double Size(const Scene& scene) {
  Vec2d low = scene.bodies[0].position, high = low;
  for (const Body& body : scene.bodies) {
    low = low.cwiseMin(Vec2d(body.position.array() - body.radius));
    high = high.cwiseMax(Vec2d(body.position.array() + body.radius));
  }
  return (high - low).norm();
}

class SceneCheck {
 public:
  SceneCheck(const Scene& scene, std::uint32_t seed)
      : scene_(scene),
        walls_(WallPartsOf(scene)),
        random_(~seed),
        simulator_(MakeSimulator("event", scene, Precision::kDouble)),
        initial_(InitialState(scene)),
        control_(InitialControl(scene, simulator_->num_steps())),
        force_(static_cast<size_t>(scene.num_bodies()), scene.gravity) {
    for (int i = 0; i < scene.num_bodies(); ++i) force_[i] = scene.bodies[i].mass * scene.gravity;
    for (int c = 0; c < scene.num_controlled(); ++c) force_[scene.control.bodies[c]] += scene.control.initial[c];
  }

  Counts Run(bool gradient) {
    if (!simulator_->Rollout(initial_, control_)) {
      const std::string why = simulator_->FailureReason();
      if (why.find("not finite") != std::string::npos) {
        Fail("a state is not finite");
      } else {
        Count(kRefusal + why.substr(why.find(": ") + 2, why.rfind(" (") - why.find(": ") - 2));
      }
      return counts_;
    }
    CountTouches();
    if (NumUnresolvedSteps(*simulator_) > 0) Count("scenes with steps taken at once");
    CheckStates();
    if (gradient) CheckGradient();
    return counts_;
  }

 private:
  void Count(const std::string& what, int64_t number = 1) { counts_[what] += number; }
  void Fail(const std::string& what) { Count(kFailure + what); }

  void CountTouches() {
    const std::vector<StepTouch>& touches = simulator_->touches();
    int impacts = 0;
    for (size_t k = 0; k < touches.size(); ++k) {
      impacts += touches[k].touch.kind == ContactKind::kImpact;
      lasting_ |= touches[k].touch.kind == ContactKind::kSustained;
      grazing_ |= touches[k].touch.kind == ContactKind::kGrazing;
      for (size_t j = k; j-- > 0 && TimeOf(touches[k]) - TimeOf(touches[j]) <= kTolerance * scene_.duration;) {
        tied_ |= ShareADisc(touches[j].touch.candidate, touches[k].touch.candidate);
      }
    }
    Count("impacts", impacts);
    if (impacts > 0) Count("scenes with impacts");
    if (lasting_) Count("scenes with rest or sliding");
    if (grazing_) Count("scenes with grazing");
    if (tied_) Count("scenes with events of one disc at the same time");
    if (scene_.contact.friction > 0) Count("scenes with friction");
  }

  double TimeOf(const StepTouch& touch) const { return touch.step * simulator_->step() + touch.touch.time; }

  // Not counting the same pair twice, nor fixed discs, which nothing changes.
  bool ShareADisc(const Candidate& c, const Candidate& d) const {
    if (c == d) return false;
    const auto has = [&](const Candidate& e, int i) { return e.a == i || (!e.plane && e.b == i); };
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      if (!scene_.bodies[i].fixed && has(c, i) && has(d, i)) return true;
    }
    return false;
  }

  void CheckStates() {
    std::vector<double> state(static_cast<size_t>(simulator_->state_size()));
    double overlap = 0, growth = 0, largest = 0, fastest = 0, before = 0, momentum_error = 0, momentum_scale = 0;
    // The work of the forces over the size of the scene is the scale of energy of a scene at rest.
    const double size = Size(scene_);
    for (int i = 0; i < scene_.num_bodies(); ++i) largest += scene_.bodies[i].fixed ? 0 : force_[i].norm() * size;
    double angular_at_start = 0, angular_error = 0, angular_scale = 0;
    Vec2d momentum_at_start = Vec2d::Zero(), pushed = Vec2d::Zero();
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      if (!scene_.bodies[i].fixed) pushed += force_[i];
    }
    for (int k = 0; k <= simulator_->num_steps(); ++k) {
      simulator_->GetState(k, state);
      const std::vector<double> x = ToInitial(state, scene_.num_bodies());
      if (!std::all_of(x.begin(), x.end(), [](double value) { return std::isfinite(value); })) {
        return Fail("a state is not finite");
      }
      overlap = std::max(overlap, LargestOverlap(scene_, walls_, x));
      double energy = 0, kinetic_energy = 0, angular = 0;
      Vec2d momentum = Vec2d::Zero();
      for (int i = 0; i < scene_.num_bodies(); ++i) {
        const Body& body = scene_.bodies[i];
        if (body.fixed) continue;
        const double inertia = SpinInertia(body), spin = AngularVelocityOf(scene_, x, i);
        const double kinetic = 0.5 * (body.mass * VelocityOf(x, i).squaredNorm() + inertia * spin * spin);
        const Vec2d arm = PositionOf(x, i) - scene_.bodies[0].position;
        angular += body.mass * Dot(Perpendicular(arm), VelocityOf(x, i)) + inertia * spin;
        angular_scale =
            std::max(angular_scale, body.mass * arm.norm() * VelocityOf(x, i).norm() + inertia * std::abs(spin));
        const double potential = -Dot(force_[i], Vec2d(PositionOf(x, i) - body.position));
        energy += kinetic + potential;
        kinetic_energy += kinetic;
        momentum += body.mass * VelocityOf(x, i);
        momentum_scale = std::max(momentum_scale, body.mass * VelocityOf(x, i).norm());
      }
      fastest = std::max(fastest, kinetic_energy);
      if (k > 0) growth = std::max(growth, energy - before);
      before = energy;
      if (k == 0) momentum_at_start = momentum;
      if (k == 0) angular_at_start = angular;
      angular_error = std::max(angular_error, std::abs(angular - angular_at_start));
      const Vec2d expected = momentum_at_start + k * simulator_->step() * pushed;
      momentum_error = std::max(momentum_error, (momentum - expected).norm());
    }
    largest += fastest;
    momentum_scale += simulator_->num_steps() * simulator_->step() * pushed.norm();
    if (!(overlap <= kTolerance * size)) Fail("overlap above 1e-9");
    if (!(growth <= kTolerance * largest)) Fail(growth <= 1e-6 * largest ? "energy grows above 1e-9" : "energy grows");
    const bool isolated =
        walls_.empty() && std::none_of(scene_.bodies.begin(), scene_.bodies.end(), [](auto& b) { return b.fixed; });
    if (isolated && !(momentum_error <= kTolerance * momentum_scale)) Fail("momentum changes");
    const bool unforced = std::ranges::all_of(force_, [](const Vec2d& force) { return force.isZero(0); });
    const bool all_spin = std::ranges::all_of(scene_.bodies, [](const Body& body) { return body.Spins(); });
    if (isolated && unforced && all_spin) {
      Count("scenes that keep angular momentum");
      if (!(angular_error <= kTolerance * angular_scale)) Fail("angular momentum changes");
    }
  }

  std::optional<double> Loss(std::span<const double> initial, std::span<const double> control) {
    if (!simulator_->Rollout(initial, control)) return std::nullopt;
    std::vector<double> end(static_cast<size_t>(simulator_->state_size()));
    simulator_->GetState(simulator_->num_steps(), end);
    return TerminalLoss(scene_.objective, end, simulator_->body_size());
  }

  void CheckGradient() {
    std::vector<double> end(static_cast<size_t>(simulator_->state_size())), cotangent(end.size());
    simulator_->GetState(simulator_->num_steps(), end);
    TerminalGradient(scene_.objective, end, simulator_->body_size(), cotangent);
    Sensitivity gradient;
    simulator_->Adjoint(cotangent, false, &gradient);
    const auto finite = [](const std::vector<double>& values) {
      return std::all_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
    };
    Count("gradients");
    if (!finite(gradient.initial) || !finite(gradient.control)) return Fail("gradient is not finite");
    const double loss = TerminalLoss(scene_.objective, end, simulator_->body_size());
    Compare("position", 0, gradient, loss);
    Compare("velocity", 2, gradient, loss);
    if (scene_.Spins()) Compare("angular velocity", 4, gradient, loss);
    if (!control_.empty()) Compare("control", -1, gradient, loss);
  }

  // One side of a directional derivative, or why there is none.
  struct Side {
    std::optional<double> slope;
    std::string why;
  };

  // By differences at four widths, extrapolated. What must first come to rest again takes a time that grows like the
  // root of the width.
  Side Slope(const std::vector<double>& initial, const std::vector<double>& control, double sign, double loss,
             double size, const Differences& differences, double width) {
    std::array<double, 4> slopes;
    for (double& slope : slopes) {
      std::vector<double> x = initial_, u = control_;
      for (size_t i = 0; i < x.size(); ++i) x[i] += sign * width * initial[i];
      for (size_t i = 0; i < u.size(); ++i) u[i] += sign * width * control[i];
      if (LargestOverlap(scene_, walls_, x) > kOverlapTolerance) return {{}, "discs would overlap"};
      const std::optional<double> moved = Loss(x, u);
      if (!moved) return {{}, "not finite"};
      slope = sign * (*moved - loss) / width;
      width /= lasting_ ? 4 : 2;
    }
    // Through three slopes, at 1, 1/2 and 1/4 of the largest width or of its root, the parabola's value at 0.
    const auto extrapolate = [&](int k) { return slopes[k] / 3 - 2 * slopes[k + 1] + slopes[k + 2] * 8 / 3; };
    const double coarse = extrapolate(0), fine = extrapolate(1);
    const double allowed = differences.smooth * (size + std::abs(fine));
    // The last alone should be near as well, or it is by chance that the others agree.
    const bool smooth = std::abs(fine - coarse) <= allowed && std::abs(fine - slopes[3]) <= 10 * allowed;
    if (!smooth) return {{}, "not smooth"};
    return {fine, ""};
  }

  // Returns the entries of the initial state by which the loss has one-sided derivatives only, with their sides.
  std::map<size_t, OneSided::Side> SidesOfInitial() const {
    std::map<size_t, OneSided::Side> sides;
    for (const OneSided& at : OneSidedDerivatives(ToNaturalUnits(scene_))) {
      const int offset = at.quantity == OneSided::Quantity::kPosition ? 0 : 2;
      sides[4 * at.body + offset + at.component] = at.side;
    }
    return sides;
  }

  // Along a random direction of the entries offset, offset + 1 of each disc's initial state; of the angular velocities
  // for 4, and -1 for the control. Where
  // derivatives exist from one side only, a direction to that side.
  void Compare(const std::string& name, int offset, const Sensitivity& gradient, double loss) {
    std::vector<double> initial(initial_.size()), control(control_.size());
    double slope = 0, size = 0;
    bool one_sided = false;
    const auto choose = [&](double low, double high, double derivative, double* entry) {
      *entry = random_.Uniform(low, high);
      slope += derivative * *entry;
      size += std::abs(derivative * *entry);
    };
    const std::map<size_t, OneSided::Side> known = SidesOfInitial();
    const size_t moves = 4 * scene_.bodies.size();
    for (size_t i = 0; i < scene_.bodies.size() && offset == 4; ++i) {
      const size_t j = moves + kSpin * i + 1;
      if (scene_.bodies[i].Spins()) choose(-1, 1, gradient.initial[j], &initial[j]);
    }
    for (size_t j = 0; j < moves && offset >= 0; ++j) {
      if (scene_.bodies[j / 4].fixed || static_cast<int>(j % 4) / 2 != offset / 2) continue;
      const auto found = known.find(j);
      if (found == known.end()) {
        choose(-1, 1, gradient.initial[j], &initial[j]);
      } else if (found->second != OneSided::Side::kNone) {
        const bool above = found->second == OneSided::Side::kAbove;
        choose(above ? 0 : -1, above ? 1 : 0, gradient.initial[j], &initial[j]);
        one_sided = true;
      }
    }
    for (size_t k = 0; k < control.size() && offset < 0; ++k) choose(-1, 1, gradient.control[k], &control[k]);
    const std::string about = "gradient by " + name + ": ";
    const auto zero = [](double entry) { return entry == 0; };
    if (std::ranges::all_of(initial, zero) && std::ranges::all_of(control, zero)) {
      return Count(about + "left out: no derivative to any side");
    }
    // The largest change is the width of a difference: a smaller one would be lost in what counts as rest.
    double longest = 0;
    for (const double entry : initial) longest = std::max(longest, std::abs(entry));
    for (const double entry : control) longest = std::max(longest, std::abs(entry));
    for (double& entry : initial) entry /= longest;
    for (double& entry : control) entry /= longest;
    slope /= longest;
    size = std::max(size / longest, kSmallestDerivative);

    const Differences& differences = lasting_ ? kAtRest : kAtImpacts;
    const auto agrees = [&](const Side& side) {
      return std::abs(*side.slope - slope) <= differences.agreement * (size + std::abs(*side.slope));
    };
    const auto take = [&](double sign) {
      const auto slope_at = [&](double width) { return Slope(initial, control, sign, loss, size, differences, width); };
      const double widest = std::min(differences.width, kLargestChange / size);
      Side side = slope_at(widest);
      // A disagreement by chance does not happen again at another width; and the first impacts may be so slow, or the
      // motion so sensitive, that all wider displacements lead to another motion.
      for (double width = 0.3 * widest; !(side.slope && agrees(side)) && width > kFinest; width *= 0.1) {
        if (const Side finer = slope_at(width); finer.slope && agrees(finer)) return finer;
      }
      return side;
    };
    if (size * kFinest > kFinestChange) return Count(about + "left out: too large for any difference");
    const std::array<Side, 2> sides = {take(1), one_sided ? Side{{}, "no derivative"} : take(-1)};
    int agree = 0, disagree = 0;
    for (const Side& side : sides) {
      if (side.slope) (agrees(side) ? agree : disagree) += 1;
    }
    const std::string where = lasting_ ? " (rest or sliding)" : "";
    const bool undefined = grazing_ || tied_;
    if (agree == 2) return Count(about + "agrees on both sides" + where);
    if (agree == 1 && disagree == 0) {
      return Count(about + "agrees on one side; the other: " + (sides[0].slope ? sides[1].why : sides[0].why) + where);
    }
    if (agree == 0 && disagree == 0) return Count(about + "left out: " + sides[0].why + " on either side" + where);
    if (undefined) return Count(about + "left out: differs at " + (grazing_ ? "a grazing contact" : "a tie"));
    if (agree == 1 && lasting_) return Count(about + "agrees with one side of a kink" + where);
    Fail(about + (agree == 1 ? "a kink" : "disagrees") + where);
  }

  const Scene& scene_;
  const std::vector<WallPart> walls_;
  testing::RandomScenes random_;
  std::unique_ptr<Simulator> simulator_;
  std::vector<double> initial_, control_;
  std::vector<Vec2d> force_;  // of gravity and control, on each disc
  Counts counts_;
  bool lasting_ = false, grazing_ = false, tied_ = false;
};

}  // namespace

Counts Check(const Scene& scene, std::uint32_t seed, bool gradient) { return SceneCheck(scene, seed).Run(gradient); }

}  // namespace saltus::campaign
