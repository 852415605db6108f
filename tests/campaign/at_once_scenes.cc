// Random scenes in which events happen at the same time on purpose, and what their gradients must be.
#include <cmath>
#include <map>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "audit/gradient/step_study.h"
#include "campaign/checks.h"
#include "campaign/scenes.h"
#include "contact/random_scene.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/events.h"
#include "saltus/simulate/one_sided_derivatives.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"

namespace saltus::campaign {
namespace {

using testing::RandomScenes;

// A disc that is at a place at a time, if nothing meets it before.
void AddDisc(const Vec2d& place, double time, const Vec2d& velocity, double radius, double mass, Scene* scene) {
  scene->bodies.push_back({.name = "disc" + std::to_string(scene->num_bodies()),
                           .radius = radius,
                           .mass = mass,
                           .position = place - time * velocity + (0.5 * time * time) * scene->gravity,
                           .velocity = velocity - time * scene->gravity});
}

void AddPlane(const Vec2d& point, const Vec2d& normal, Scene* scene) {
  scene->planes.push_back({"plane" + std::to_string(scene->planes.size()), point, normal});
}

double AnyMass(RandomScenes* random) { return random->Chance(0.5) ? 1 : random->Uniform(0.3, 3); }

// On a node, in the middle of a step, or anywhere.
double AnyTime(RandomScenes* random, const Scene& scene) {
  const double step = scene.dt(), k = random->Integer(1, scene.steps - 1);
  return step * (random->Chance(0.5) ? k : random->Chance(0.5) ? k + 0.5 : random->Uniform(1, scene.steps - 1));
}

// One to three discs, each of which strikes both walls of a corner of a room at once.
void Corners(RandomScenes* random, Scene* scene) {
  const double angle = random->Chance(0.3) ? 0 : random->Uniform(0, 2 * std::numbers::pi);
  const Vec2d along(std::cos(angle), std::sin(angle)), across = Perpendicular(along), center = random->InSquare(3);
  if (random->Chance(0.3)) scene->gravity = random->InSquare(3);
  for (const Vec2d& normal : {along, across}) {
    AddPlane(center - 2 * normal, normal, scene);
    AddPlane(center + 2 * normal, -normal, scene);
  }
  for (int k = random->Integer(1, 3); k > 0; --k) {
    const double radius = random->Uniform(0.1, 0.3), a = random->Sign(), b = random->Sign();
    const Vec2d place = center + (2 - radius) * (a * along + b * across);
    const Vec2d velocity = random->Uniform(0.2, 3) * a * along + random->Uniform(0.2, 3) * b * across;
    AddDisc(place, AnyTime(random, *scene), velocity, radius, AnyMass(random), scene);
  }
}

// Discs on a lattice in a room, whose velocities are of few kinds.
void Lattice(RandomScenes* random, Scene* scene) {
  const int width = random->Integer(2, 3), height = random->Integer(1, 3);
  const double spacing = 0.5, radius = 0.125, speed = random->Chance(0.5) ? 1 : random->Uniform(0.5, 2);
  const double mass = random->Chance(0.7) ? 1 : 0;
  for (int i = 0; i < width; ++i) {
    for (int j = 0; j < height; ++j) {
      if (random->Chance(0.3)) continue;
      const Vec2d velocity = speed * Vec2d(random->Integer(-1, 1), random->Integer(-1, 1));
      AddDisc(spacing * Vec2d(i, j), 0, velocity, radius, mass > 0 ? mass : AnyMass(random), scene);
    }
  }
  for (const Vec2d& normal : {Vec2d(1, 0), Vec2d(0, 1)}) {
    if (random->Chance(0.3)) continue;
    AddPlane(-spacing * Vec2d(1, 1), normal, scene);
    AddPlane(spacing * Vec2d(width, height), -normal, scene);
  }
}

// Discs and their mirror images, above a ground and between walls.
void Mirrored(RandomScenes* random, Scene* scene) {
  if (random->Chance(0.4)) scene->gravity = {0, -random->Uniform(0.5, 5)};
  for (int k = random->Integer(1, 3); k > 0; --k) {
    const Vec2d place(random->Uniform(0.3, 1.5), random->Uniform(0.3, 1.5)), velocity = random->InSquare(2);
    const double radius = random->Uniform(0.1, 0.25), mass = AnyMass(random);
    AddDisc(place, 0, velocity, radius, mass, scene);
    AddDisc({-place[0], place[1]}, 0, {-velocity[0], velocity[1]}, radius, mass, scene);
  }
  if (random->Chance(0.8)) AddPlane({0, 0}, {0, 1}, scene);
  if (random->Chance(0.5)) {
    AddPlane({2, 0}, {-1, 0}, scene);
    AddPlane({-2, 0}, {1, 0}, scene);
  }
}

// Discs that each strike a wall of their own at one time, often on a node.
void AtOneTime(RandomScenes* random, Scene* scene) {
  if (random->Chance(0.4)) scene->gravity = random->InSquare(3);
  const double time = AnyTime(random, *scene);
  AddPlane({0, 0}, {0, 1}, scene);
  for (int k = random->Integer(1, 4); k > 0; --k) {
    const double radius = random->Uniform(0.1, 0.3);
    const Vec2d velocity(random->Uniform(-1, 1), -random->Uniform(0.3, 3));
    AddDisc({1.5 * k, radius}, time, velocity, radius, AnyMass(random), scene);
  }
}

// A disc that meets two others, or walls, at one time: at a right angle as often as not.
void Star(RandomScenes* random, Scene* scene) {
  const double time = AnyTime(random, *scene), radius = random->Uniform(0.1, 0.3);
  const double first = random->Chance(0.5) ? 0 : random->Uniform(0, 2 * std::numbers::pi);
  const double second =
      first + random->Sign() * (random->Chance(0.7) ? std::numbers::pi / 2 : random->Uniform(0.5, std::numbers::pi));
  const Vec2d towards[] = {{std::cos(first), std::sin(first)}, {std::cos(second), std::sin(second)}};
  const Vec2d velocity =
      random->Uniform(0.3, 2) * towards[0] + random->Uniform(0.3, 2) * towards[1] + 0.1 * random->InSquare(1);
  AddDisc({0, 0}, time, velocity, radius, AnyMass(random), scene);
  for (const Vec2d& direction : towards) {
    if (random->Chance(0.5)) {
      AddPlane(radius * direction, -direction, scene);
    } else {
      const double other = random->Uniform(0.1, 0.3);
      const Vec2d moves = random->Chance(0.3) ? Vec2d(velocity - 2 * Dot(velocity, direction) * direction)
                                              : Vec2d(-random->Uniform(0, 1) * direction);
      AddDisc((radius + other) * direction, time, moves, other, AnyMass(random), scene);
    }
  }
}

constexpr struct {
  const char* name;
  void (*make)(RandomScenes*, Scene*);
} kKinds[] = {
    {"corners", Corners}, {"lattice", Lattice}, {"mirrored", Mirrored}, {"at one time", AtOneTime}, {"star", Star}};

// ---------------------------------------------------------------------------------------------------------------------
// What must hold

constexpr double kAgreement = 1e-5;  // of a gradient with differences, of the largest entry of its quantity
constexpr double kSmooth = 1e-6;     // of extrapolations with each other
constexpr double kWidest = 1e-3, kFinest = 3e-6;  // of widths: discs moved along each other by w meet w^2 later

class AtOnceCheck {
 public:
  // In natural units, so that the widths of differences suit scenes of every size.
  explicit AtOnceCheck(const Scene& scene)
      : scene_(ToNaturalUnits(scene)),
        simulator_(MakeSimulator("event", scene_, Precision::kDouble)),
        initial_(InitialState(scene_)) {}

  Counts Run() {
    if (!simulator_->Rollout(initial_, {})) {
      const std::string why = simulator_->FailureReason();
      Count(kRefusal + why.substr(why.find(": ") + 2, why.rfind(" (") - why.find(": ") - 2));
      return counts_;
    }
    for (const StepTouch& touch : simulator_->touches()) {
      if (touch.touch.kind != ContactKind::kImpact) return LeaveOut("discs rest or graze");
    }
    if (NumUnresolvedSteps(*simulator_) > 0) return LeaveOut("steps taken at once");
    if (!TiesOf(*simulator_).empty()) return LeaveOut("the order of impacts decides the motion");
    Count("impacts", static_cast<int64_t>(simulator_->touches().size()));
    std::vector<double> end(static_cast<size_t>(simulator_->state_size())), cotangent(end.size());
    simulator_->GetState(simulator_->num_steps(), end);
    TerminalGradient(scene_.objective, end, simulator_->body_size(), cotangent);
    simulator_->Adjoint(cotangent, false, &gradient_);
    loss_ = TerminalLoss(scene_.objective, end, simulator_->body_size());
    FindNamed();
    for (int i = 0; i < 4 * scene_.num_bodies(); ++i) CheckEntry(i);
    return counts_;
  }

 private:
  struct Side {
    bool agrees = false;
    std::optional<double> other;  // the slope that there is instead
  };

  void Count(const std::string& what, int64_t number = 1) { counts_[what] += number; }
  Counts LeaveOut(const std::string& why) {
    Count("scenes left out: " + why);
    return counts_;
  }

  void FindNamed() {
    std::vector<OneSided> named = OneSidedDerivatives(scene_);
    for (const OneSided& entry : OneSidedBySimultaneousEvents("event", scene_, named)) named.push_back(entry);
    for (const OneSided& entry : named) {
      const int offset = entry.quantity == OneSided::Quantity::kPosition ? 0 : 2;
      named_[4 * entry.body + offset + entry.component] = entry.side;
    }
  }

  double Largest(int entry) const {
    double largest = 1e-3;
    for (size_t i = 0; i < initial_.size(); ++i) {
      if (static_cast<int>(i % 4) / 2 == entry % 4 / 2) largest = std::max(largest, std::abs(gradient_.initial[i]));
    }
    return largest;
  }

  Side Follow(int entry, double sign) {
    const double largest = Largest(entry);
    Side side;
    for (double width = kWidest; width > kFinest && !side.agrees; width *= 0.1) {
      double slopes[4];
      for (int k = 0; k < 4; ++k) {
        std::vector<double> x = initial_, end(static_cast<size_t>(simulator_->state_size()));
        x[entry] += sign * std::ldexp(width, -k);
        if (!simulator_->Rollout(x, {})) return {};
        simulator_->GetState(simulator_->num_steps(), end);
        const double loss = TerminalLoss(scene_.objective, end, simulator_->body_size());
        slopes[k] = sign * (loss - loss_) / std::ldexp(width, -k);
      }
      const auto extrapolate = [&](int k) { return slopes[k] / 3 - 2 * slopes[k + 1] + slopes[k + 2] * 8 / 3; };
      const double slope = extrapolate(1), size = largest + std::abs(slope);
      side.agrees = std::abs(slope - gradient_.initial[entry]) <= kAgreement * size;
      if (std::abs(slope - extrapolate(0)) <= kSmooth * size) side.other = slope;
    }
    return side;
  }

  void CheckEntry(int entry) {
    const Side below = Follow(entry, -1), above = Follow(entry, 1);
    const auto found = named_.find(entry);
    const bool named = found != named_.end();
    if (below.agrees && above.agrees) {
      return Count(named ? kFailure + std::string("named, but agrees on both sides") : "entries agree on both sides");
    }
    if ((!below.agrees && !below.other) || (!above.agrees && !above.other)) {
      return Count("entries left out: differences of a side do not settle");
    }
    if (!below.agrees && !above.agrees) {
      if (named && found->second == OneSided::Side::kNone) return Count("entries of neither side, named");
      return Count(kFailure + std::string("of neither side, not named"));
    }
    const auto side = above.agrees ? OneSided::Side::kAbove : OneSided::Side::kBelow;
    if (named && found->second == side) return Count("entries one-sided, named");
    Count(kFailure + std::string(named ? "one-sided, named otherwise" : "one-sided, not named"));
  }

  const Scene scene_;
  std::unique_ptr<Simulator> simulator_;
  const std::vector<double> initial_;
  Sensitivity gradient_;
  double loss_ = 0;
  std::map<int, OneSided::Side> named_;
  Counts counts_;
};

}  // namespace

NamedScene RandomSceneAtOnce(std::uint32_t seed) {
  RandomScenes random(seed);
  const auto& kind = kKinds[seed % std::size(kKinds)];
  while (true) {
    Scene scene;
    scene.name = "seed_" + std::to_string(seed);
    scene.duration = random.Chance(0.5) ? 1 : random.Uniform(0.5, 2);
    scene.steps = random.Chance(0.5) ? 32 : random.Integer(3, 60);
    scene.contact.restitution = random.Chance(0.4) ? 1 : random.Uniform(0.3, 1);
    if (random.Chance(0.2)) scene.contact.friction = random.Uniform(0, 1);
    kind.make(&random, &scene);
    MeasureEnd(&random, &scene);
    if (!Validate(scene)) return {kind.name, scene};  // else some discs overlap
  }
}

Counts CheckAtOnce(const Scene& scene) { return AtOnceCheck(scene).Run(); }

}  // namespace saltus::campaign
