// What is wrong over one contact, and why.
#include "audit/attribution/attributor.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <utility>

#include "saltus/scene/geometry.h"
#include "saltus/simulate/registry.h"

namespace saltus::internal {
namespace {

// How much smaller steps are when asking whether a force is resolved, at most and at least.
constexpr int kFiner = 32, kLeastFiner = 4;
constexpr int kMostFineSteps = 8192;

}  // namespace

double Attributor::Norm(const Eigen::VectorXd& costate, const std::vector<int>& bodies) const {
  const Eigen::VectorXd scales = StateScales(scene_, bodies, scene_.duration);
  double sum = 0;
  for (int i = 0; i < costate.size(); ++i) {
    const double entry = costate[i] / scales[i];
    sum += entry * entry;
  }
  return std::sqrt(sum);
}

StepMap Attributor::ExactOver(const Interval& interval, const std::vector<int>* bodies) const {
  if (bodies != nullptr && IsCrowd()) return MapOver(exact_contact_, interval, 1, *bodies);
  const int steps = interval.end - interval.begin;
  const std::unique_ptr<Simulator> exact = SimulatorOf(exact_contact_, interval, steps);
  const std::vector<double> begin = PlainStateAt(interval.begin);
  if (bodies == nullptr) return RunSteps(*exact, begin, ForcesFrom(interval.begin), steps);
  return ComposeSteps(*exact, begin, ForcesFrom(interval.begin), steps, *bodies);
}

std::vector<StepTouch> Attributor::TouchesOver(const Contact& contact, const Interval& interval) const {
  const std::unique_ptr<Simulator> simulator = SimulatorOf(contact, interval, interval.end - interval.begin);
  simulator->Rollout(ToInitial(PlainStateAt(interval.begin), scene_.num_bodies()),
                     InitialControl(simulator->scene(), simulator->num_steps()));
  return simulator->touches();
}
std::vector<StepTouch> Attributor::ExactTouches(const Interval& interval) const {
  return IsCrowd() ? TouchesOver(exact_contact_, interval) : ExactOver(interval, nullptr).touches;
}
std::vector<StepTouch> Attributor::OwnTouches(const Interval& interval) const {
  if (IsCrowd()) return TouchesOver(contact_, interval);
  const int steps = interval.end - interval.begin;
  return RunSteps(model(), StateAt(interval.begin), ForcesFrom(interval.begin), steps).touches;
}

// The model's own linearization over some discs, perhaps with finer steps.
StepMap Attributor::OwnMap(const Interval& interval, const std::vector<int>& bodies, int finer) const {
  if (IsCrowd()) return MapOver(contact_, interval, finer, bodies);
  const int steps = (interval.end - interval.begin) * finer;
  std::unique_ptr<Simulator> fine;
  if (finer > 1) fine = SimulatorOf(contact_, interval, steps);
  const Simulator& simulator = finer > 1 ? *fine : model();
  return ComposeSteps(simulator, StateAt(interval.begin), ForcesFrom(interval.begin, finer), steps, bodies);
}

// The linearization over some discs, which no others meet in the interval: in a crowd they are simulated alone.
StepMap Attributor::MapOver(const Contact& contact, const Interval& interval, int finer,
                            const std::vector<int>& bodies) const {
  const int steps = (interval.end - interval.begin) * finer;
  Scene scene = SceneOver(contact, interval, steps);
  scene.control = {};
  scene.objective.terminal.clear();
  scene.free.clear();
  scene.free_spin.clear();
  scene.bodies.clear();
  std::vector<int> local;
  const std::vector<double> begin_state = PlainStateAt(interval.begin);
  std::vector<double> moves, turns;
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    const bool wanted = std::binary_search(bodies.begin(), bodies.end(), i);
    if (!wanted && !scene_.bodies[i].fixed) continue;
    const int at = scene.num_bodies();
    if (wanted) local.push_back(at);
    scene.bodies.push_back(scene_.bodies[i]);
    const auto state = begin_state.begin() + size_ * i;
    moves.insert(moves.end(), state, state + 4);
    turns.insert(turns.end(), state + 4, state + size_);
    for (int c = 0; c < scene_.num_controlled(); ++c) {
      if (scene_.control.bodies[c] != i) continue;
      scene.control.bodies.push_back(at);
      scene.control.initial.push_back(scene_.control.initial[c]);
    }
    for (int t = 0; t < scene_.num_turned(); ++t) {
      if (scene_.control.turned[t] != i) continue;
      scene.control.turned.push_back(at);
      scene.control.initial_torque.push_back(scene_.control.initial_torque[t]);
    }
  }
  const std::unique_ptr<Simulator> simulator = Simulate(contact, scene);
  const std::vector<double> control = InitialControl(scene, simulator->num_steps());
  const auto force = [&](int k, std::span<double> f) { simulator->ExpandForce(control, k, f); };
  if (scene.Spins()) moves.insert(moves.end(), turns.begin(), turns.end());
  std::vector<double> begin(simulator->state_size());
  simulator->ExpandInitial(moves, begin);
  StepMap map = ComposeSteps(*simulator, begin, force, steps, local);
  if (NumbersOfDisc(scene) == size_) return map;
  // None of these spins: they turn evenly, as in the whole scene.
  const int n = static_cast<int>(local.size());
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(size_ * n, size_ * n);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) A.block<4, 4>(size_ * i, size_ * j) = map.A.block<4, 4>(4 * i, 4 * j);
    A.block<2, 2>(size_ * i + 4, size_ * i + 4) << 1, scene.duration, 0, 1;
  }
  map.A = std::move(A);
  return map;
}

Eigen::VectorXd Attributor::PullBackOver(int begin, int end, const Eigen::VectorXd& costate) const {
  std::vector<int> all(model_->num_bodies());
  std::iota(all.begin(), all.end(), 0);
  return PullBackOver(contact_, {begin, end, {}}, 1, all, costate).Sum();
}

PulledCostate Attributor::PullBackOver(const Contact& contact, const Interval& interval, int finer,
                                       const std::vector<int>& bodies, const Eigen::VectorXd& lambda) const {
  const std::unique_ptr<Simulator> simulator = SimulatorOf(contact, interval, (interval.end - interval.begin) * finer);
  return PullBackCostate(simulator.get(), PlainStateAt(interval.begin), bodies, lambda);
}

void Attributor::KeepConnected(Interval interval, std::vector<StepTouch>* exact, std::vector<StepTouch>* own,
                               std::vector<int>* bodies) const {
  const auto involved = [&](const StepTouch& at) { return Involves(interval, at.touch.candidate); };
  for (bool grown = true; grown;) {
    grown = false;
    for (const std::vector<StepTouch>* touches : {exact, own}) {
      for (const StepTouch& at : *touches) {
        const bool known = std::any_of(interval.meetings.begin(), interval.meetings.end(), [&](const Meeting& meeting) {
          return meeting.pair == at.touch.candidate;
        });
        if (known || !involved(at)) continue;
        interval.meetings.push_back({at.touch.candidate, at.step, at.step});
        grown = true;
      }
    }
  }
  std::erase_if(*exact, std::not_fn(involved));
  std::erase_if(*own, std::not_fn(involved));
  for (const Meeting& meeting : interval.meetings) {
    bodies->push_back(meeting.pair.a);
    if (!meeting.pair.plane) bodies->push_back(meeting.pair.b);
  }
  std::sort(bodies->begin(), bodies->end());
  bodies->erase(std::unique(bodies->begin(), bodies->end()), bodies->end());
  std::erase_if(*bodies, [&](int body) { return scene_.bodies[body].fixed; });
}

ContactError Attributor::Compare(const Interval& interval, const Eigen::VectorXd& costate) const {
  ContactError error;
  error.first_step = interval.first_touch();
  error.last_step = interval.last_touch();
  const auto first = std::find_if(interval.meetings.begin(), interval.meetings.end(), [&](const Meeting& meeting) {
    return meeting.first == error.first_step;
  });
  error.a = scene_.bodies[first->pair.a].name;
  error.b = first->pair.plane ? walls_[first->pair.b].name : scene_.bodies[first->pair.b].name;

  std::vector<StepTouch> own = OwnTouches(interval);
  std::vector<StepTouch> exact_touches = ExactTouches(interval);
  std::vector<int> bodies;
  KeepConnected(interval, &exact_touches, &own, &bodies);
  const int n = static_cast<int>(bodies.size());
  Eigen::VectorXd lambda(size_ * n);
  for (int i = 0; i < n; ++i) {
    lambda.segment(size_ * i, size_) = costate.segment(bodies[i] * model().body_size(), size_);
  }
  error.exact_impacts = static_cast<int>(exact_touches.size());
  if (IsCrowd() && n > kMostDiscsByMatrices) {
    CompareCrowd(interval, bodies, lambda, exact_touches, &error);
    return error;
  }
  StepMap exact = ExactOver(interval, &bodies);
  exact.touches = exact_touches;
  const StepMap approximate = OwnMap(interval, bodies);
  const Eigen::MatrixXd difference = approximate.A - exact.A;
  const double scale = std::max(Norm(exact.A.transpose() * lambda, bodies), 1e-300);
  error.error = Norm(difference.transpose() * lambda, bodies) / scale;
  error.block = LargestBlock([&](bool to_velocity, bool from_velocity) {
    Eigen::VectorXd part = Eigen::VectorXd::Zero(size_ * n);
    for (int r = 0; r < size_ * n; ++r) {
      if (IsRate(r % size_) != to_velocity) continue;
      for (int c = 0; c < size_ * n; ++c) {
        if (IsRate(c % size_) == from_velocity) part[c] += difference(r, c) * lambda[r];
      }
    }
    return Norm(part, bodies);
  });
  if (error.error > kSmallError) error.why = Why(interval, exact, approximate, bodies);
  return error;
}

Block Attributor::LargestBlock(const std::function<double(bool to_velocity, bool from_velocity)>& size) {
  Block largest_block = Block::kPositionFromPosition;
  double largest = -1;
  for (const Block block : {Block::kPositionFromPosition,
                            Block::kVelocityFromPosition,
                            Block::kPositionFromVelocity,
                            Block::kVelocityFromVelocity}) {
    const bool to_velocity = block == Block::kVelocityFromPosition || block == Block::kVelocityFromVelocity;
    const bool from_velocity = block == Block::kPositionFromVelocity || block == Block::kVelocityFromVelocity;
    const double here = size(to_velocity, from_velocity);
    if (here <= largest) continue;
    largest = here;
    largest_block = block;
  }
  return largest_block;
}

// By what the costate sees of the linearizations, which is all that the gradient has of them.
void Attributor::CompareCrowd(const Interval& interval, const std::vector<int>& bodies, const Eigen::VectorXd& lambda,
                              const std::vector<StepTouch>& exact, ContactError* error) const {
  const PulledCostate right = PullBackOver(exact_contact_, interval, 1, bodies, lambda);
  const PulledCostate own = PullBackOver(contact_, interval, 1, bodies, lambda);
  const double size = Norm(own.Sum() - right.Sum(), bodies), scale = std::max(Norm(right.Sum(), bodies), 1e-300);
  error->error = size / scale;
  error->block = LargestBlock([&](bool to_velocity, bool from_velocity) {
    Eigen::VectorXd part =
        to_velocity ? own.by_velocities - right.by_velocities : own.by_positions - right.by_positions;
    for (int c = 0; c < part.size(); ++c) {
      if (IsRate(c % size_) != from_velocity) part[c] = 0;
    }
    return Norm(part, bodies);
  });
  if (error->error <= kSmallError) return;
  if (const std::string plain = WhyWithoutMaps(interval, exact); !plain.empty()) {
    error->why = plain;
  } else if (interval.longest() > 1) {
    const PulledCostate fine = PullBackOver(contact_, interval, FinerSteps(interval), bodies, lambda);
    error->why = DescribeUnresolved(interval, size, Norm(fine.Sum() - right.Sum(), bodies));
  } else {
    error->why = WhyInOneStep(exact);
  }
}

std::optional<PairImpact> Attributor::OnlyImpact(const Interval& interval, const StepMap& exact) const {
  if (exact.touches.size() != 1 || interval.meetings.size() != 1) return std::nullopt;
  const StepTouch& at = exact.touches.front();
  const Candidate& pair = at.touch.candidate;
  if (at.touch.kind != ContactKind::kImpact || !(pair == interval.meetings.front().pair)) return std::nullopt;

  // The exact state at the begin of the step with the impact, and from there to the impact.
  Interval until = interval;
  until.end = interval.begin + at.step;
  std::vector<double> x = PlainStateAt(interval.begin);
  if (at.step > 0) x = ExactOver(until, nullptr).end;
  std::vector<double> force(model_->force_size());
  ForcesFrom(interval.begin)(at.step, force);
  const double time = at.touch.time;
  struct Motion {
    Vec2d p, v, a;
    double inverse_mass;
  };
  const auto motion = [&](int i) -> Motion {
    const Body& body = scene_.bodies[i];
    const double* disc = &x[size_ * i];
    const Vec2d p(disc[0], disc[1]), v(disc[2], disc[3]);
    if (body.fixed) return {p, Vec2d::Zero(), Vec2d::Zero(), 0.0};
    const Vec2d a = Vec2d(force[2 * i], force[2 * i + 1]) / body.mass + scene_.gravity;
    return {p + time * (v + 0.5 * time * a), v + time * a, a, 1 / body.mass};
  };
  const Motion a = motion(pair.a);
  PairImpact impact;
  impact.inverse_mass_a = a.inverse_mass;
  impact.velocity_a = a.v;
  impact.acceleration_a = a.a;
  impact.velocity_b = impact.acceleration_b = Vec2d::Zero();
  if (pair.plane) {
    const Wall<double>& wall = walls_[pair.b].wall;
    const Separation<double> at_wall = Separate<double>(a.p, wall);
    impact.normal = at_wall.normal;
    if (wall.curved()) impact.inverse_distance = 1 / (at_wall.distance + wall.side * wall.radius);
  } else {
    const Motion b = motion(pair.b);
    impact.normal = (a.p - b.p).normalized();
    impact.inverse_distance = 1 / (a.p - b.p).norm();
    impact.inverse_mass_b = b.inverse_mass;
    impact.velocity_b = b.v;
    impact.acceleration_b = b.a;
  }
  for (int side = 0; side < (pair.plane ? 1 : 2); ++side) {
    const int i = side == 0 ? pair.a : pair.b;
    const Body& body = scene_.bodies[i];
    impact.radius[side] = body.radius;
    if (!body.Spins()) continue;
    impact.inverse_inertia[side] = 1 / body.MomentOfInertia();
    impact.spin[side] = x[size_ * i + 5];
    if (scene_.num_turned() == 0) continue;
    const double torque = body.radius * force[2 * scene_.bodies.size() + i];
    impact.spin[side] += time * torque * impact.inverse_inertia[side];
  }
  impact.spins = scene_.Spins();
  impact.restitution = scene_.contact.restitution;
  impact.friction = scene_.contact.friction;
  impact.mode = at.touch.mode;
  impact.before = at.step * h() + time;
  impact.after = (interval.end - interval.begin) * h() - impact.before;
  impact.step = h();
  return impact;
}

// By how much the steps of an interval are cut to see if its forces are resolved.
int Attributor::FinerSteps(const Interval& interval) const {
  return std::clamp(kMostFineSteps / (interval.end - interval.begin), kLeastFiner, kFiner);
}

// The same model over the same interval with far smaller steps.
std::string Attributor::WhyUnresolved(const Interval& interval, const StepMap& exact, const StepMap& approximate,
                                      const std::vector<int>& bodies) const {
  const StepMap fine = OwnMap(interval, bodies, FinerSteps(interval));
  const Eigen::VectorXd scales = StateScales(scene_, bodies, scene_.duration);
  const double coarse_error = ScaledNorm(approximate.A - exact.A, scales);
  const double fine_error = ScaledNorm(fine.A - exact.A, scales);
  return DescribeUnresolved(interval, coarse_error, fine_error);
}

std::string Attributor::DescribeUnresolved(const Interval& interval, double coarse_error, double fine_error) const {
  const int lasts = interval.longest();
  char text[128];
  if (fine_error < 0.5 * coarse_error) {
    std::snprintf(text,
                  sizeof text,
                  "contact force not resolved by its %d steps (%d times as many leave %.0f %% of the error)",
                  lasts,
                  FinerSteps(interval),
                  100 * fine_error / coarse_error);
  } else {
    std::snprintf(text,
                  sizeof text,
                  "contact is soft: it lasts %.2g s, and smaller steps do not help",
                  lasts * h() * scene_.units.time);
  }
  return text;
}

// What the touches alone say; empty if nothing.
std::string Attributor::WhyWithoutMaps(const Interval& interval, const std::vector<StepTouch>& exact) {
  if (exact.empty()) return "touches where the exact motion does not";
  const bool rests = std::any_of(
      exact.begin(), exact.end(), [](const StepTouch& at) { return at.touch.kind == ContactKind::kSustained; });
  return rests || interval.end - interval.begin >= kLongest ? "a contact that lasts" : "";
}

std::string Attributor::WhyInOneStep(const std::vector<StepTouch>& exact) {
  return exact.size() > 1 ? std::to_string(exact.size()) + " impacts in one step" : "no known cause";
}

std::string Attributor::Why(const Interval& interval, const StepMap& exact, const StepMap& approximate,
                            const std::vector<int>& bodies) const {
  if (const std::string plain = WhyWithoutMaps(interval, exact.touches); !plain.empty()) return plain;
  if (interval.longest() > 1) return WhyUnresolved(interval, exact, approximate, bodies);
  if (const std::optional<PairImpact> impact = OnlyImpact(interval, exact)) {
    // Bodies are in the order of their indices, and so are the two of a pair.
    if (const std::optional<std::string> fault = RecogniseFault(*impact, approximate.A, scene_.duration)) return *fault;
  }
  return WhyInOneStep(exact.touches);
}

}  // namespace saltus::internal
