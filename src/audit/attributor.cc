// What is wrong over one contact, and why.
#include "audit/attributor.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <utility>

#include "saltus/dynamics/registry.h"
#include "saltus/physics/geometry.h"

namespace saltus::internal {
namespace {

// How much smaller steps are when asking whether a force is resolved, at most and at least.
constexpr int kFiner = 32, kLeastFiner = 4;
constexpr int kMostFineSteps = 8192;

}  // namespace

double Attributor::Norm(const Eigen::VectorXd& costate) const {
  double sum = 0;
  for (int i = 0; i < costate.size(); ++i) {
    const double entry = costate[i] / (i % 4 < 2 ? 1.0 : scene_.duration);
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
  simulator->Rollout(PlainStateAt(interval.begin), InitialControl(simulator->scene(), simulator->num_steps()));
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
  scene.bodies.clear();
  std::vector<int> local;
  std::vector<double> begin;
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    const bool wanted = std::binary_search(bodies.begin(), bodies.end(), i);
    if (!wanted && !scene_.bodies[i].fixed) continue;
    const int at = scene.num_bodies();
    if (wanted) local.push_back(at);
    scene.bodies.push_back(scene_.bodies[i]);
    const auto state = PlainStateAt(interval.begin).begin() + 4 * i;
    begin.insert(begin.end(), state, state + 4);
    for (int c = 0; c < scene_.num_controlled(); ++c) {
      if (scene_.control.bodies[c] != i) continue;
      scene.control.bodies.push_back(at);
      scene.control.initial.push_back(scene_.control.initial[c]);
    }
  }
  const std::unique_ptr<Simulator> simulator = Simulate(contact, scene);
  const std::vector<double> control = InitialControl(scene, simulator->num_steps());
  const auto force = [&](int k, std::span<double> f) { simulator->ExpandForce(control, k, f); };
  return ComposeSteps(*simulator, begin, force, steps, local);
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
  error.b = first->pair.plane ? scene_.planes[first->pair.b].name : scene_.bodies[first->pair.b].name;

  std::vector<StepTouch> own = OwnTouches(interval);
  std::vector<StepTouch> exact_touches = ExactTouches(interval);
  std::vector<int> bodies;
  KeepConnected(interval, &exact_touches, &own, &bodies);
  const int n = static_cast<int>(bodies.size());
  Eigen::VectorXd lambda(4 * n);
  for (int i = 0; i < n; ++i) lambda.segment<4>(4 * i) = costate.segment<4>(bodies[i] * model().body_size());
  error.exact_impacts = static_cast<int>(exact_touches.size());
  if (IsCrowd() && n > kCrowd) {
    CompareCrowd(interval, bodies, lambda, exact_touches, &error);
    return error;
  }
  StepMap exact = ExactOver(interval, &bodies);
  exact.touches = exact_touches;
  const StepMap approximate = OwnMap(interval, bodies);
  const Eigen::MatrixXd difference = approximate.A - exact.A;
  const double scale = std::max(Norm(exact.A.transpose() * lambda), 1e-300);
  error.error = Norm(difference.transpose() * lambda) / scale;
  error.block = LargestBlock([&](bool to_velocity, bool from_velocity) {
    Eigen::VectorXd part = Eigen::VectorXd::Zero(4 * n);
    for (int r = 0; r < 4 * n; ++r) {
      if ((r % 4 >= 2) != to_velocity) continue;
      for (int c = 0; c < 4 * n; ++c) {
        if ((c % 4 >= 2) == from_velocity) part[c] += difference(r, c) * lambda[r];
      }
    }
    return Norm(part);
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
  const double size = Norm(own.Sum() - right.Sum()), scale = std::max(Norm(right.Sum()), 1e-300);
  error->error = size / scale;
  error->block = LargestBlock([&](bool to_velocity, bool from_velocity) {
    Eigen::VectorXd part =
        to_velocity ? own.by_velocities - right.by_velocities : own.by_positions - right.by_positions;
    for (int c = 0; c < part.size(); ++c) {
      if ((c % 4 >= 2) != from_velocity) part[c] = 0;
    }
    return Norm(part);
  });
  if (error->error <= kSmallError) return;
  if (const std::string plain = WhyWithoutMaps(interval, exact); !plain.empty()) {
    error->why = plain;
  } else if (interval.longest() > 1) {
    const PulledCostate fine = PullBackOver(contact_, interval, FinerSteps(interval), bodies, lambda);
    error->why = DescribeUnresolved(interval, size, Norm(fine.Sum() - right.Sum()));
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
  std::vector<double> force(2 * model_->num_bodies());
  ForcesFrom(interval.begin)(at.step, force);
  const double time = at.touch.time;
  struct Motion {
    Vec2d p, v, a;
    double inverse_mass;
  };
  const auto motion = [&](int i) -> Motion {
    const Body& body = scene_.bodies[i];
    const Vec2d p(x[4 * i], x[4 * i + 1]), v(x[4 * i + 2], x[4 * i + 3]);
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
    impact.normal = scene_.planes[pair.b].normal.normalized();
  } else {
    const Motion b = motion(pair.b);
    impact.normal = (a.p - b.p).normalized();
    impact.inverse_distance = 1 / (a.p - b.p).norm();
    impact.inverse_mass_b = b.inverse_mass;
    impact.velocity_b = b.v;
    impact.acceleration_b = b.a;
  }
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
  const double coarse_error = ScaledNorm(approximate.A - exact.A, scene_.duration);
  const double fine_error = ScaledNorm(fine.A - exact.A, scene_.duration);
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
