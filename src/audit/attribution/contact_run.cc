#include "audit/attribution/contact_run.h"

#include <glog/logging.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <deque>
#include <numeric>

#include "audit/attribution/step_map.h"
#include "saltus/scene/geometry.h"
#include "saltus/scene/walls.h"
#include "simulate/impact.h"

namespace saltus {
namespace {

// Thresholds of changes of velocity, relative to the closing speed.
constexpr double kRounding = 1e-13;
constexpr double kFelt = 1e-6;    // a contact may have begun; less is a force from afar
constexpr double kMet = 1e-2;     // the sum at which it has
constexpr double kOver = 1e-3;    // less than this, while the pair parts, ends it
constexpr double kAtRest = 1e-2;  // slower than this for long enough, it has come to rest
// The number of steps since the contact began after which a slow pair is at rest; springs reverse it far sooner.
constexpr int kRestAtLeast = 4, kRestTimes = 4;
constexpr int kMostSteps = 4096;
// The steps at the closing speed within which nothing else may be: among several contacts no single law shows.
constexpr double kApart = 16;
constexpr int kLead = RunRecorder::kLead;
// A closing speed that the acceleration can make in this many steps is that of a contact at rest.
constexpr double kRestingSteps = 4;

StepLinearization::FreeFlight FreeFlightOf(const Simulator& simulator) {
  StepLinearization step;
  std::vector<double> x(simulator.state_size());
  simulator.ExpandInitial(InitialState(simulator.scene()), x);
  simulator.Linearize(x, std::vector<double>(simulator.force_size()), /*with_parameters=*/false, &step);
  return step.free;
}

// Consecutive steps in which a pair has touched, and the change of velocity in each, m/s.
struct Touching {
  Candidate pair;
  int begin = 0;
  std::vector<double> changes;
  bool crowded = false;  // something else was close when it began

  int end() const { return begin + static_cast<int>(changes.size()); }
  double sum() const { return std::accumulate(changes.begin(), changes.end(), 0.0); }
  // Returns how many of the last steps have changed the velocity by more than `change`.
  int NumChangedSteps(double change) const {
    const auto less = [change](double other) { return std::abs(other) <= change; };
    return static_cast<int>(std::find_if(changes.rbegin(), changes.rend(), less) - changes.rbegin());
  }
};

// Whether another body is within `margin` of a moving disc of the pair.
bool HasNearbyBody(const Scene& scene, const std::vector<WallPart>& walls, const Candidate& pair,
                   std::span<const double> x, int body_size, double margin) {
  const auto position = [&](int i) { return Vec2d(x[i * body_size], x[i * body_size + 1]); };
  const auto near = [&](int disc, int other, bool plane) {
    const double radius = scene.bodies[disc].radius;
    if (plane) {
      return walls[other].extent.Covers(position(disc)) && walls[other].LeastDistance(position(disc)) < radius + margin;
    }
    return (position(disc) - position(other)).norm() < radius + scene.bodies[other].radius + margin;
  };
  const auto crowded = [&](int disc) {
    if (scene.bodies[disc].fixed) return false;
    for (int i = 0; i < scene.num_bodies(); ++i) {
      const bool in_pair = i == pair.a || (!pair.plane && i == pair.b);
      if (!in_pair && near(disc, i, /*plane=*/false)) return true;
    }
    for (int i = 0; i < static_cast<int>(walls.size()); ++i) {
      if (!(pair.plane && i == pair.b) && near(disc, i, /*plane=*/true)) return true;
    }
    return false;
  };
  return crowded(pair.a) || (!pair.plane && crowded(pair.b));
}

// Returns the record of a pair, a new one if the pair has not touched in the step before.
Touching& FindTouching(const StepTouch& at, std::vector<Touching>* all) {
  const Candidate& pair = at.touch.candidate;
  const auto known = std::find_if(all->begin(), all->end(), [&](const Touching& t) { return t.pair == pair; });
  Touching& touching = known == all->end() ? all->emplace_back() : *known;
  if (touching.changes.empty() || at.step > touching.end()) touching = {pair, at.step, {}};
  return touching;
}

}  // namespace

PairMotion::PairMotion(const Simulator& simulator, const StepLinearization::FreeFlight& free, const Candidate& pair,
                       std::span<const double> force)
    : simulator_(simulator), free_(free), pair_(pair) {
  const Scene& scene = simulator.scene();
  const auto acceleration = [&](int body) -> Vec2d {
    if (scene.bodies[body].fixed) return Vec2d::Zero();
    return Vec2d(force[2 * body], force[2 * body + 1]) * InverseMass(scene.bodies[body]) + scene.gravity;
  };
  if (pair.plane) wall_ = WallPartsOf(scene)[pair.b].wall;
  acceleration_ = pair.plane ? acceleration(pair.a) : Vec2d(acceleration(pair.a) - acceleration(pair.b));
}

Vec2d PairMotion::Relative(std::span<const double> x, int offset) const {
  const auto of = [&](int body) {
    const int at = body * simulator_.body_size() + offset;
    return Vec2d(x[at], x[at + 1]);
  };
  return pair_.plane ? of(pair_.a) : Vec2d(of(pair_.a) - of(pair_.b));
}

Vec2d PairMotion::NormalAt(std::span<const double> x) const {
  if (pair_.plane) return Separate<double>(Relative(x, 0), wall_).normal;
  return Relative(x, 0).normalized();
}

double PairMotion::Speed(std::span<const double> x) const { return Dot(NormalAt(x), Relative(x, 2)); }

double PairMotion::Change(std::span<const double> from, std::span<const double> to) const {
  const Vec2d flown = free_.vp * Relative(from, 0) + free_.vv * Relative(from, 2) + free_.va * acceleration_;
  return Dot(NormalAt(from), Vec2d(Relative(to, 2) - flown));
}

bool PairMotion::IsResting(std::span<const double> x) const {
  return -Speed(x) <= kRestingSteps * simulator_.step() * std::abs(Dot(NormalAt(x), acceleration_));
}

std::optional<Encounter> FindEncounter(const Contact& contact, const Scene& scene, const StopRequest& stop) {
  const std::unique_ptr<Simulator> model = MakeSimulator(contact, scene, Precision::kDouble);
  model->set_stop(stop);
  const std::vector<double> control = InitialControl(scene, model->num_steps());
  if (!model->Rollout(InitialState(scene), control)) return std::nullopt;
  const auto state = [&](int k) {
    std::vector<double> x(model->state_size());
    model->GetState(k, x);
    return x;
  };
  const StepLinearization::FreeFlight free = FreeFlightOf(*model);
  const std::vector<WallPart> walls = WallPartsOf(scene);
  std::vector<Touching> pairs;
  for (const StepTouch& at : model->touches()) {
    Touching& touching = FindTouching(at, &pairs);
    if (at.step < touching.end()) continue;
    Encounter encounter{at.step, touching.pair, {}, std::vector<double>(model->force_size())};
    model->ExpandForce(control, at.step, encounter.force);
    const PairMotion motion(*model, free, touching.pair, encounter.force);
    const std::vector<double> x = state(at.step);
    touching.changes.push_back(motion.Change(x, state(at.step + 1)));
    const double closing = -motion.Speed(x);
    if (touching.crowded || motion.IsResting(x) || std::abs(touching.sum()) < kMet * closing) continue;
    touching.crowded =
        HasNearbyBody(scene, walls, touching.pair, x, model->body_size(), kApart * closing * model->step());
    if (touching.crowded) continue;
    // A force that sets in smoothly begins before its effect exceeds the threshold.
    const int earlier = 2 * (touching.NumChangedSteps(kFelt * closing) - 1);
    encounter.step = std::max(touching.begin, at.step - earlier);
    encounter.before = state(std::max(0, encounter.step - kLead));
    return encounter;
  }
  return std::nullopt;
}

std::unique_ptr<Simulator> ModelBench::MakeSimulatorOfLength(double h) const {
  Scene scene = scene_;
  scene.duration = h;
  scene.steps = CHECK_NOTNULL(FindContactModel(contact_))->grid_steps;
  std::unique_ptr<Simulator> simulator = MakeSimulator(contact_, scene, Precision::kDouble);
  simulator->set_stop(stop_);
  return simulator;
}

void RunRecorder::Add(double change, double speed, bool touched, std::span<const double> before) {
  ++run_.steps;
  if (touched && std::abs(change) > kRounding) {
    ++run_.touched;
    if (run_.touched == 2) run_.first_full = std::abs(change);
    if (!run_.begins) run_.before.assign(before.begin(), before.end());
    run_.begins = true;
    sum_ += std::abs(change);
    if (std::abs(change) > largest_) {
      largest_ = std::abs(change);
      run_.before_largest.assign(before.begin(), before.end());
    }
  }
  if (std::abs(change) > kFelt || felt_ > 0) ++felt_;
  at_rest_ = std::abs(speed) < kAtRest ? at_rest_ + 1 : 0;
  const bool parts = run_.begins && speed > 0 && std::abs(change) < kOver * largest_;
  const bool rests = felt_ > 0 && at_rest_ >= kRestAtLeast + kRestTimes * (felt_ - at_rest_);
  run_.ends = parts || rests || (onset_only_ && run_.touched >= 2);
  if (run_.ends) run_.rebound = parts ? speed : 0.0;
}

const ContactRun& RunRecorder::Finish() {
  run_.concentration = sum_ > 0 ? largest_ / sum_ : 0.0;
  return run_;
}

ContactRun ModelBench::Run(double h, std::span<const double> from, bool onset_only) const {
  const std::unique_ptr<Simulator> simulator = MakeSimulatorOfLength(h);
  const PairMotion pair(*simulator, FreeFlightOf(*simulator), encounter_.pair, encounter_.force);
  RunRecorder recorder(onset_only);
  std::deque<std::vector<double>> past;  // at most kLead + 1 states, the last one current
  past.emplace_back(from.begin(), from.end());
  std::vector<double> next(from.size());
  std::vector<Touch> touches;
  double closing = 0;
  for (int step = 0; step < kMostSteps && !recorder.ended(); ++step) {
    if (simulator->stopped()) return {};
    const std::vector<double>& x = past.back();
    touches.clear();
    simulator->Step(x, encounter_.force, next, &touches);
    if (!recorder.begun()) closing = -pair.Speed(x);
    const double change = pair.Change(x, next) / closing;
    const double speed = pair.Speed(next) / closing;
    if (!std::isfinite(change) || !(closing > 0)) return {};
    const bool touched = std::any_of(
        touches.begin(), touches.end(), [&](const Touch& touch) { return touch.candidate == encounter_.pair; });
    recorder.Add(change, speed, touched, past.front());
    past.push_back(next);
    if (past.size() > kLead + 1) past.pop_front();
  }
  return recorder.Finish();
}

NormalMap ModelBench::Linearize(double h, std::span<const double> before_largest) const {
  const std::unique_ptr<Simulator> simulator = MakeSimulatorOfLength(h);
  const Candidate& pair = encounter_.pair;
  const PairMotion motion(*simulator, FreeFlightOf(*simulator), pair, encounter_.force);
  struct Moving {
    int body;
    double side, share;  // in the relative motion
  };
  const double mass_a = InverseMass(scene_.bodies[pair.a]);
  const double mass_b = pair.plane ? 0.0 : InverseMass(scene_.bodies[pair.b]);
  std::vector<Moving> moving;
  if (mass_a > 0) moving.push_back({pair.a, 1, mass_a / (mass_a + mass_b)});
  if (mass_b > 0) moving.push_back({pair.b, -1, mass_b / (mass_a + mass_b)});
  std::vector<int> bodies;
  for (const Moving& disc : moving) bodies.push_back(disc.body);
  const auto force = [this](int, std::span<double> out) {
    std::copy_n(encounter_.force.begin(), out.size(), out.begin());
  };
  const Eigen::MatrixXd A = RunSteps(*simulator, before_largest, force, kLead + 1 + kLead, &bodies).A;

  const int size = NumbersOfDisc(scene_);
  // Restricts to relative normal motion: the discs are displaced so that their centre of mass stays.
  const Vec2d n = motion.NormalAt(before_largest);
  Eigen::Matrix2d map = Eigen::Matrix2d::Zero(), flight;
  for (size_t i = 0; i < moving.size(); ++i) {
    for (size_t j = 0; j < moving.size(); ++j) {
      for (int r = 0; r < 2; ++r) {
        for (int c = 0; c < 2; ++c) {
          const Eigen::Matrix2d block = A.block<2, 2>(size * i + 2 * r, size * j + 2 * c);
          map(r, c) += moving[i].side * moving[j].side * moving[j].share * n.dot(block * n);
        }
      }
    }
  }
  const StepLinearization::FreeFlight& free = motion.free();
  flight << free.pp, free.pv, free.vp, free.vv;
  const Eigen::Matrix2d back = flight.inverse();
  for (int i = 0; i < kLead; ++i) map = back * map * back;
  return {map(0, 0), map(1, 0)};
}

}  // namespace saltus
